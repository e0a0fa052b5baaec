# Somebody with an episode of their own. A procedural one stands for it.
rogs synth --out kitchen --episodes 1 --seed 11 --size 154x84 --frames 24
rogs list kitchen/episodes
rogs init kitchen/episodes
rogs plan kitchen.toml
rogs run kitchen.toml
rogs status runs/kitchen
test -s runs/kitchen/report/index.html
