"""The examples run, on the records of the repository."""

import pathlib
import subprocess
import sys

import numpy as np
import pytest

EXAMPLES = pathlib.Path(__file__).resolve().parents[1] / "examples"


def run(name, *arguments):
    words = [sys.executable, EXAMPLES / name, *arguments]
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_field_becomes_a_point_cloud_over_time(outputs, tmp_path):
    said = run("point_cloud_over_time.py", outputs, tmp_path / "cloud.npz", "--opacity", "0.01")
    cloud = np.load(tmp_path / "cloud.npz")
    times, count, _ = cloud["points"].shape
    assert times == len(cloud["times"]) and count == len(cloud["moving"]) == len(cloud["link"]) > 0
    assert f"{count} of" in said


def test_another_method_is_scored_beside_the_field(outputs):
    said = run("score_another_method.py", outputs)
    assert "other method" in said and "rogs field" in said


def test_a_rerun_recording_is_written(outputs, tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    run("rerun_recording.py", outputs, tmp_path / "clip.rrd", "--opacity", "0.01")
    assert (tmp_path / "clip.rrd").stat().st_size > 10_000
