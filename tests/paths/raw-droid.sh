# Somebody with raw DROID: a tree LAB/OUTCOME/DATE/TIME. A procedural tree stands for it.
rogs list droid
rogs init droid --robot kitchen/robot/panda_synth.urdf --out droid.toml
rogs plan droid.toml
rogs run droid.toml
