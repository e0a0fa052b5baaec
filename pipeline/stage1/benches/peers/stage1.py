"""Parts of the Stage-1 network in PyTorch, float32 and bfloat16, from their formulas, with random weights.

Reads one JSON object from the first line of standard input: sizes of the network (as in a checkpoint's
`rogs.configuration`), `frames`, `grid`, `size`, `threads`. Every further line names a part, which is run once; the answer is
a line with its seconds of wall and of processor time. What is not a matter of time (positions, norms' values) is left out
where it costs nothing.
"""

import json
import sys
import time

import torch
import torch.nn.functional as F

job = json.loads(sys.stdin.readline())
torch.set_num_threads(job["threads"])
torch.manual_seed(0)
WIDTH, HEADS = job["width"], job["heads"]
FRAMES, GRID, SIZE = job["frames"], job["grid"], job["size"]


def weight(*shape):
    fan_in = 1
    for side in shape[1:]:
        fan_in *= side
    return torch.randn(*shape) / fan_in**0.5


class Block:
    """x + g1 * attention(norm x), x + g2 * mlp(norm x), with QK norm and rotary embedding."""

    def __init__(self, rotary):
        c, d = WIDTH, WIDTH // HEADS
        self.norms = [(torch.ones(c), torch.zeros(c)) for _ in range(2)]
        self.head_norms = [(torch.ones(d), torch.zeros(d)) for _ in range(2)]
        self.qkv, self.qkv_bias = weight(3 * c, c), torch.zeros(3 * c)
        self.proj, self.proj_bias = weight(c, c), torch.zeros(c)
        self.fc1, self.fc1_bias = weight(4 * c, c), torch.zeros(4 * c)
        self.fc2, self.fc2_bias = weight(c, 4 * c), torch.zeros(c)
        self.gammas = [torch.full((c,), 0.01) for _ in range(2)]
        self.rotary = rotary

    def turn(self, x):
        """Halves for rows and columns; in each, split halves are rotated by position times frequency."""
        cosine, sine = self.rotary
        parts = []
        for axis, half in enumerate(x.chunk(2, -1)):
            a, b = half.chunk(2, -1)
            c, s = cosine[axis], sine[axis]
            parts += [a * c - b * s, b * c + a * s]
        return torch.cat(parts, -1)

    def __call__(self, x):
        batch, tokens, c = x.shape
        qkv = F.linear(F.layer_norm(x, (c,), *self.norms[0]), self.qkv, self.qkv_bias)
        q, k, v = qkv.view(batch, tokens, 3, HEADS, c // HEADS).permute(2, 0, 3, 1, 4)
        if self.rotary is not None:
            size = (c // HEADS,)
            q = self.turn(F.layer_norm(q, size, *self.head_norms[0]))
            k = self.turn(F.layer_norm(k, size, *self.head_norms[1]))
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(batch, tokens, c)
        x = x + self.gammas[0] * F.linear(mixed, self.proj, self.proj_bias)
        hidden = F.gelu(F.linear(F.layer_norm(x, (c,), *self.norms[1]), self.fc1, self.fc1_bias))
        return x + self.gammas[1] * F.linear(hidden, self.fc2, self.fc2_bias)


class Head:
    """Four token maps to one map at image size."""

    def __init__(self, outputs):
        f, hidden, channels = job["head_features"], job["head_hidden"], job["head_channels"]
        self.outputs = outputs
        self.projects = [weight(c, 2 * WIDTH, 1, 1) for c in channels]
        self.resizes = [
            weight(channels[0], channels[0], 4, 4),
            weight(channels[1], channels[1], 2, 2),
            None,
            weight(channels[3], channels[3], 3, 3),
        ]
        self.narrow = [weight(f, c, 3, 3) for c in channels]
        self.units = [[(weight(f, f, 3, 3), torch.zeros(f)) for _ in range(4)] for _ in range(4)]
        self.outs = [weight(f, f, 1, 1) for _ in range(4)]
        self.conv1 = weight(f // 2, f, 3, 3)
        self.conv2, self.conv3 = weight(hidden, f // 2, 3, 3), weight(outputs, hidden, 1, 1)

    def unit(self, x, pair):
        x = F.relu(x)
        y = F.conv2d(x, *pair[0], padding=1)
        return F.conv2d(F.relu(y), *pair[1], padding=1) + x

    def __call__(self, taps):
        maps = []
        for level, tokens in enumerate(taps):
            batch = tokens.shape[0]
            tokens = F.layer_norm(tokens, (2 * WIDTH,))
            x = tokens.transpose(1, 2).reshape(batch, 2 * WIDTH, *GRID)
            x = F.conv2d(x, self.projects[level])
            if level == 0:
                x = F.conv_transpose2d(x, self.resizes[0], stride=4)
            elif level == 1:
                x = F.conv_transpose2d(x, self.resizes[1], stride=2)
            elif level == 3:
                x = F.conv2d(x, self.resizes[3], stride=2, padding=1)
            maps.append(F.conv2d(x, self.narrow[level], padding=1))
        y = None
        for level in (3, 2, 1, 0):
            x = maps[level]
            if y is not None:
                x = y + self.unit(x, self.units[level][:2])
            x = self.unit(x, self.units[level][2:])
            size = maps[level - 1].shape[2:] if level else [2 * side for side in x.shape[2:]]
            # The 1x1 convolution commutes with the resampling.
            x = F.conv2d(x, self.outs[level])
            y = F.interpolate(x, size=tuple(size), mode="bilinear", align_corners=True)
        y = F.conv2d(y, self.conv1, padding=1)
        y = F.interpolate(y, size=tuple(SIZE), mode="bilinear", align_corners=True)
        return F.conv2d(F.relu(F.conv2d(y, self.conv2, padding=1)), self.conv3)


def rotary(frames):
    """Cosines and sines per axis, `[tokens, quarter of a head]`; special tokens at position 0."""
    quarter = WIDTH // HEADS // 4
    special = job["registers"] + 3
    rows = [0] * special + [r + 1 for r in range(GRID[0]) for _ in range(GRID[1])]
    columns = [0] * special + [c + 1 for _ in range(GRID[0]) for c in range(GRID[1])]
    frequencies = 100.0 ** (-torch.arange(quarter) / quarter)
    angles = [torch.tensor(p * frames)[:, None] * frequencies for p in (rows, columns)]
    return [a.cos() for a in angles], [a.sin() for a in angles]


special, patches = job["registers"] + 3, GRID[0] * GRID[1]
frame_tokens = torch.randn(FRAMES, special + patches, WIDTH)
all_tokens = frame_tokens.reshape(1, -1, WIDTH)
frame_block, global_block = Block(rotary(1)), Block(rotary(FRAMES))
encoder_block = Block(None)
head = Head(2)
taps = [torch.randn(1, patches, 2 * WIDTH) for _ in range(4)]


def whole():
    """Image encoder, aggregator, depth and attribute heads: lifting without query times."""
    tokens = torch.randn(FRAMES, 1 + job["registers"] + patches, WIDTH)
    for _ in range(job["encoder_blocks"]):
        tokens = encoder_block(tokens)
    x, kept = frame_tokens, []
    for pair in range(job["pairs"]):
        x = frame_block(x)
        y = global_block(x.reshape(1, -1, WIDTH)).reshape(x.shape)
        if pair in job["taps"]:
            kept.append(torch.cat([x, y], -1)[:, special:])
        x = y
    for _ in range(2):
        for frame in range(FRAMES):
            head([tap[frame : frame + 1] for tap in kept])


PARTS = {
    "frame block": lambda: frame_block(frame_tokens),
    "global block": lambda: global_block(all_tokens),
    "dense head, one frame": lambda: head(taps),
    "whole lifting": whole,
}

for line in sys.stdin:
    name = line.strip().removesuffix(", bf16")
    with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16, enabled="bf16" in line):
        wall, processor = time.perf_counter(), time.process_time()
        PARTS[name]()
        print(json.dumps([time.perf_counter() - wall, time.process_time() - processor]), flush=True)
