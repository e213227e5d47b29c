"""The ghost video: a file of its own with both halves, or a sentence why not."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from dropo.cli.main import main


def test_both_halves_move(fit_folder, tmp_path):
    """A frame for each control step; the halves differ: the left one shows the model before."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    page = tmp_path / "p.html"
    small = (
        "import sys; from dropo.cli.main import main; from dropo.report.robot import video; "
        "video.WIDTH = video.HEIGHT = 96; video.EACH = 1; "
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
    assert json.loads(done.stdout) == {"report": str(page), "video": str(page.with_suffix(".mp4"))}
    unpack = [
        ffmpeg.get_ffmpeg_exe(),
        "-i",
        str(page.with_suffix(".mp4")),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    frames = subprocess.run(unpack, capture_output=True, check=True).stdout
    shown = np.frombuffer(frames, np.uint8).reshape(-1, 96, 192, 3)
    assert len(shown) == 4 * 20
    halves = [
        np.stack([frame[:, part] for frame in shown[::10]]).astype(float)
        for part in (slice(0, 96), slice(96, None))
    ]
    assert all(np.abs(np.diff(half, axis=0)).max() > 50 for half in halves)
    assert np.abs(halves[0] - halves[1]).max() > 50
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.html", "p.mp4"]


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
