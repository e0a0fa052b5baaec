# Somebody with a LeRobot data set, which has no calibration: the wrist camera of DROID is known well enough without one.
rogs list "$ROGS_SHARED/data/lerobot_v30_droid"
rogs init "$ROGS_SHARED/data/lerobot_v30_droid" --calibration "$ROGS_REPOSITORY/manifests/calibration/droid-wrist-nominal.json" --out set.toml
sed -i 's|^# cameras = .*|cameras = [{ id = "wrist", from = "observation.images.wrist_left" }]|; s|^# limit = 1|limit = 1|' set.toml
rogs plan set.toml
rogs run set.toml
