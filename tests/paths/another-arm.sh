# Somebody with an arm that no preset knows: the manifest names its parts, forward kinematics tells whether they are right.
rogs synth --out kitchen --episodes 1 --seed 11 --size 154x84 --frames 24
sed 's/panda_joint/axis/g; s/panda_link/body/g; s/meshes.body/meshes\/panda_link/g' kitchen/robot/panda_synth.urdf > kitchen/robot/arm.urdf
rm kitchen/robot/panda_synth.urdf kitchen/robot/spec.json
sed -i 's/panda_joint/axis/g; s/panda_link/body/g' kitchen/episodes/*/episode.json kitchen/episodes/*/*.csv
rogs init kitchen/episodes --robot kitchen/robot/arm.urdf
rogs plan kitchen.toml
rogs run kitchen.toml
test -s runs/kitchen/report/index.html
