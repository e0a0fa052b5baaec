# Somebody who scores another method. Recorded images stand for its predictions.
rogs synth --out kitchen --episodes 1 --seed 11 --size 154x84 --frames 24
rogs init kitchen/episodes
rogs run kitchen.toml
rogs inspect runs/kitchen/clips/*/clip.r4c
rogs metrics kitchen/episodes/*/wrist kitchen/episodes/*/wrist
rogs table runs/kitchen
