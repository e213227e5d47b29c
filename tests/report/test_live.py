"""A page that follows a folder."""

import json
import os
import re
import shutil
import signal
import threading
import time
import urllib.error
import urllib.request

import pytest

from dropo.cli.main import main
from dropo.core.services.errors import BadArgument, BadFile
from dropo.core.services.files.progress_file import LOCK, PROGRESS
from dropo.report.live import LivePage, live_server


@pytest.fixture
def served(unfinished_folder, tmp_path):
    """A copy of an unfinished run, and the address of its page."""
    folder = shutil.copytree(unfinished_folder, tmp_path / "run")
    with live_server(folder, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def asked(address):
    """What a server answers."""
    with urllib.request.urlopen(address, timeout=30) as answer:
        return answer.read().decode()


def test_it_is_renewed_when_the_folder_changes(served):
    """From interrupted to at work; the tag changes with the files, and nothing is written."""
    folder, address = served
    before = asked(address + "tag")
    page = asked(address)
    assert "was interrupted after" in page
    assert f'tag !== "{before}"' in page
    names = sorted(path.name for path in folder.iterdir())
    assert asked(address + "tag") == before
    assert sorted(path.name for path in folder.iterdir()) == names
    step = {"at": time.time(), "fraction": 0.25, "text": "round 2", "left": "about 0:01:00 left"}
    (folder / PROGRESS).write_text(json.dumps({"steps": [step]}))
    (folder / LOCK).touch()
    assert asked(address + "tag") != before
    page = asked(address)
    for words in ("is at work, 25% is done. Round 2.", "about 0:01:00", "round 2"):
        assert words in page
    with pytest.raises(urllib.error.HTTPError, match="404"):
        asked(address + "../etc/passwd")


def test_a_file_that_is_being_written_keeps_the_last_page(served):
    """A broken file is a page of before, and the new one comes when it is whole."""
    folder, address = served
    page = asked(address)
    (folder / "fit.json").write_text("{")
    assert asked(address) == page
    (folder / "fit.json").unlink()
    (folder / LOCK).touch()
    assert "is at work" in asked(address)


def test_a_diagnosis_at_work_has_a_page(tmp_path):
    """From its record alone; the folder of another command is refused."""
    (tmp_path / "run.json").write_text(json.dumps({"command": "diagnose", "problem": "arm"}))
    (tmp_path / LOCK).touch()
    assert "This diagnosis of arm is at work. It has no result yet." in LivePage(tmp_path).text()
    (tmp_path / LOCK).unlink()
    assert "This diagnosis of arm was interrupted." in LivePage(tmp_path).text()
    (tmp_path / "run.json").write_text(json.dumps({"command": "train", "problem": "arm"}))
    with pytest.raises(BadFile, match="expected a folder that"):
        LivePage(tmp_path)


def test_refusals(unfinished_folder, served, tmp_path, capsys):
    """A port that is taken, options that do not go together, no folder: status 2, one line."""
    port = int(served[1].rstrip("/").rpartition(":")[2])
    with pytest.raises(BadArgument, match=f"port {port} cannot be had"):
        live_server(unfinished_folder, "127.0.0.1", port)
    for more, said in (
        (["--serve", "0", "--video"], "Leave out --video"),
        (["--serve", "0", "--out", str(tmp_path / "p.html")], "Leave out --out"),
        (["--host", "0.0.0.0"], "--host belongs to --serve"),
    ):
        assert main(["report", str(unfinished_folder), *more]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert main(["report", str(tmp_path / "none"), "--serve", "0"]) == 2
    assert not (tmp_path / "p.html").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_ends_it_with_0(unfinished_folder, capsys):
    """Its address is printed, and answers; nothing is written."""
    found = []

    def look():
        """Reads the page when its address is there, then presses Ctrl-C."""
        printed = ""
        while not (address := re.match(r"http://127\.0\.0\.1:\d+/", printed)):
            time.sleep(0.02)
            printed += capsys.readouterr().out
        found.append(asked(address[0]))
        os.kill(os.getpid(), signal.SIGINT)

    names = sorted(path.name for path in unfinished_folder.iterdir())
    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    assert main(["report", str(unfinished_folder), "--serve", "0"]) == 0
    thread.join(timeout=30)
    assert "evaluations" in found[0]
    assert sorted(path.name for path in unfinished_folder.iterdir()) == names
