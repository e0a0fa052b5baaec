"""Metrics against their formulas, kinematics against a chain that is written out."""

import numpy as np
import pytest
import rogs


def test_psnr_and_depth_are_their_formulas():
    random = np.random.default_rng(3)
    own = random.integers(0, 256, (20, 30, 3), np.uint8)
    other = random.integers(0, 256, (20, 30, 3), np.uint8)
    mse = np.mean((own / 255.0 - other / 255.0) ** 2)
    assert rogs.psnr(own, other) == pytest.approx(-10 * np.log10(mse), abs=1e-9)
    assert rogs.psnr(own / 255.0, other / 255.0) == pytest.approx(rogs.psnr(own, other), abs=1e-4)
    assert rogs.ssim(own, own) == pytest.approx(1.0) and rogs.ssim(own, other) < 0.2
    depth = random.uniform(0.5, 2, (20, 30)).astype(np.float32)
    reference = random.uniform(0.5, 2, (20, 30)).astype(np.float32)
    reference[:5] = np.nan
    scores = rogs.depth_scores(depth, reference)
    own, other = depth[5:].astype(float), reference[5:].astype(float)
    assert scores["pixels"] == other.size
    assert scores["absrel"] == pytest.approx(np.mean(np.abs(own - other) / other))
    assert scores["rmse_m"] == pytest.approx(np.sqrt(np.mean((own - other) ** 2)))
    assert rogs.depth_scores(depth, np.full_like(depth, np.nan)) is None


def test_wrong_images_are_refused():
    with pytest.raises(ValueError, match="channels"):
        rogs.psnr(np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 4), np.uint8))
    with pytest.raises(rogs.RogsError):
        rogs.psnr(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 5, 3), np.uint8))
    with pytest.raises(ValueError, match="torchmetrics"):
        rogs.ssim(np.zeros((20, 20, 3), np.uint8), np.zeros((20, 20, 3), np.uint8), "other")


def test_folders_are_compared_by_name(tmp_path):
    for name, value in (("a", 0.5), ("b", 0.25)):
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "one.npz", rgb=np.full((20, 20, 3), value, np.float32))
    scores = rogs.compare(tmp_path / "a", tmp_path / "b")
    assert scores["psnr"] == pytest.approx(-10 * np.log10(0.0625), abs=1e-5)


URDF = """<robot name="arm"><link name="base"/><link name="upper"/><link name="hand"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="reach" type="prismatic"><parent link="upper"/><child link="hand"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_kinematics_follow_the_chain(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    robot = rogs.Robot(path)
    assert robot.link_names == ["base", "upper", "hand"] and robot.joint_names == ["shoulder", "reach"]
    turns = np.array([0.0, np.pi / 2, 1.0])
    poses = robot.fk({"shoulder": turns, "reach": 0.1})
    assert poses.shape == (3, 3, 4, 4)
    expected = np.stack([0.3 * np.cos(turns), 0.3 * np.sin(turns), np.full(3, 0.3)], axis=1)
    assert np.allclose(poses[:, 2, :3, 3], expected)
    assert np.array_equal(robot.fk({"shoulder": 1.0, "reach": 0.1}), poses[2])
    with pytest.raises(rogs.RogsError, match="elbow"):
        robot.fk({"elbow": 1.0})
    with pytest.raises(rogs.RogsError, match="missing.urdf"):
        rogs.Robot(tmp_path / "missing.urdf")
