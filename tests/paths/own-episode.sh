# Somebody with an episode of their own, who wants a film of it. A procedural one stands for it.
rogs synth --out kitchen --episodes 1 --seed 11 --size 154x84 --frames 24
rogs list kitchen/episodes
rogs init kitchen/episodes
rogs plan kitchen.toml
rogs run kitchen.toml
rogs status runs/kitchen
test -s runs/kitchen/report/index.html
rogs render runs/kitchen/clips/*/field-1.r4c --camera ext1 --times all --beside reference --video kitchen.mp4
rogs render runs/kitchen/clips/*/field-1.r4c --camera orbit --times all --video orbit.mp4
# Without ffmpeg films are folders of images.
test -s kitchen.mp4 || test -s kitchen-frames/000000.png
test -s orbit.mp4 || test -s orbit-frames/000000.png
