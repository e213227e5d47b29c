"""The ghost video: a file of its own with both halves, or a sentence why not."""

import base64
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dropo.cli.main import main
from dropo.report.folder import Media
from dropo.report.robot.video import Shown
from dropo.report.robot.video_part import told, video_part


def test_both_halves_move(fit_folder, tmp_path):
    """In the page and beside it; the halves differ: the upper one shows the model before."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    page = tmp_path / "p.html"
    small = (
        "import sys; from dropo.cli.main import main; from dropo.report.robot import video; "
        "video.WIDTH = video.HEIGHT = 96; video.SHORTEST = 1; "
    )
    command = [
        sys.executable,
        "-c",
        f"{small}sys.exit(main())",
        "report",
        str(fit_folder),
        "--out",
        str(page),
        "--video",
        "--json",
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | {"MUJOCO_GL": "egl"}
    )
    if "MuJoCo cannot draw here" in done.stderr:
        pytest.skip("no graphics library for drawing off screen")
    assert done.returncode == 0, done.stderr
    video = page.with_suffix(".mp4")
    assert json.loads(done.stdout) == {"report": str(page), "video": str(video)}
    unpack = [
        ffmpeg.get_ffmpeg_exe(),
        "-i",
        str(video),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    frames = subprocess.run(unpack, capture_output=True, check=True).stdout
    shown = np.frombuffer(frames, np.uint8).reshape(-1, 192, 96, 3)
    seconds = 80 * 0.008
    assert len(shown) == round(2 * 20 * seconds)  # twice as slow, 20 frames a second
    halves = [
        np.stack([frame[part] for frame in shown[::4]]).astype(float)
        for part in (slice(0, 96), slice(96, None))
    ]
    assert all(np.abs(np.diff(half, axis=0)).max() > 50 for half in halves)
    assert np.abs(halves[0] - halves[1]).max() > 50
    text = page.read_text()
    inside = re.search(r'<video controls muted [^>]*src="data:video/mp4;base64,([^"]+)"', text)
    assert base64.b64decode(inside[1]) == video.read_bytes()
    assert "2 times slower" in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.html", "p.mp4"]


def test_the_caption_says_what_is_enlarged():
    """The factor, the pace and how much is shown; nothing of it where nothing is changed."""
    shown = Shown(Path("v.mp4"), 20, 10, 0.8)
    text = told(shown, "Run 1.", True)
    for words in ("enlarged 20 times", "10 times slower", "0.8 s", "above", "Run 1."):
        assert words in text
    text = told(Shown(Path("v.mp4"), 1, 1, 9.0), "", False)
    assert "as large as they are" in text
    assert "In its own time" in text
    assert "one model" in text
    assert "dropo report DIR --video" in video_part(None)
    assert "base64,AAEC" in video_part(Media(bytes([0, 1, 2]), "x"))


def test_without_model_or_motion(fit_folder, copy_of, capsys):
    """Another model, no motion kept: status 2, a sentence with the way out, and no page."""
    folder = copy_of(fit_folder)
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"model_sha256": "0"}))
    assert main(["report", str(folder), "--video"]) == 2
    assert "is not the one of this run" in capsys.readouterr().err
    (folder / "predictions.npz").unlink()
    assert main(["report", str(folder), "--video"]) == 2
    assert "leave out --video" in capsys.readouterr().err
    assert not (folder / "report.html").exists()
