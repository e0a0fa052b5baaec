"""A training update of a compact Stage-1 network in PyTorch, float32, from the formulas, with random weights.

Reads one JSON object from the first line of standard input: sizes of the network (as in a checkpoint's
`rogs.configuration`), `clips`, `frames` (of a clip, camera-major), `cameras`, `grid`, `size`, `threads`, `layout`
(`channels_last` or `contiguous`). Then makes one update for every further line and answers it with one JSON object:
seconds of wall and of processor time of the forward pass with the losses on the network's outputs, of the backward pass,
of clipping and AdamW. All clips are one batch. What cameras alone decide (rays, places of the sweep's points, position
maps) is made once, before the first update. Nothing is rendered.
"""

import json
import sys
import time

import torch
import torch.nn.functional as F
from torch import nn

job = json.loads(sys.stdin.readline())
torch.set_num_threads(job["threads"])
torch.manual_seed(0)
WIDTH, HEADS, FEATURES, HIDDEN = job["width"], job["heads"], job["head_features"], job["head_hidden"]
CLIPS, FRAMES, GRID, SIZE = job["clips"], job["frames"], job["grid"], job["size"]
IMAGES, PATCHES, DEPTHS = CLIPS * FRAMES, job["grid"][0] * job["grid"][1], job["sweep_depths"]
FORMAT = torch.channels_last if job["layout"] == "channels_last" else torch.contiguous_format
SWEPT, GROUPS = 16, 2
DECODER = [64, 64, 72]
ENCODER = [16, 32, 48]
RAYS = 8


def conv(inputs, outputs, size=3, stride=1):
    return nn.Conv2d(inputs, outputs, size, stride, size // 2)


def resized(x, size):
    return F.interpolate(x, size=tuple(size), mode="bilinear", align_corners=True)


def cells(x):
    """Pixels of 2 x 2 cells as channels; an odd side is doubled at its end."""
    x = F.pad(x, (0, x.shape[3] % 2, 0, x.shape[2] % 2), mode="replicate")
    return F.pixel_unshuffle(x, 2)


class TwoLayers(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.first, self.second = conv(inputs, outputs), conv(outputs, outputs)

    def forward(self, x):
        return F.relu(self.second(F.relu(self.first(x))))


class Block(nn.Module):
    """x + g1 * attention(norm x), x + g2 * mlp(norm x), with QK norm and rotary embedding in the aggregator."""

    def __init__(self, rotary):
        super().__init__()
        c, d = WIDTH, WIDTH // HEADS
        self.norm1, self.norm2 = nn.LayerNorm(c), nn.LayerNorm(c)
        self.rotary = rotary
        if rotary is not None:
            self.q_norm, self.k_norm = nn.LayerNorm(d), nn.LayerNorm(d)
        self.qkv, self.proj = nn.Linear(c, 3 * c), nn.Linear(c, c)
        self.fc1, self.fc2 = nn.Linear(c, 4 * c), nn.Linear(4 * c, c)
        self.gammas = nn.ParameterList([nn.Parameter(torch.full((c,), 0.3)) for _ in range(2)])

    def turn(self, x):
        cosine, sine = self.rotary
        a, b, c, d = x.chunk(4, -1)
        return x * cosine + torch.cat([b, a, d, c], -1) * sine

    def forward(self, x):
        batch, tokens, c = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(batch, tokens, 3, HEADS, c // HEADS).permute(2, 0, 3, 1, 4)
        if self.rotary is not None:
            q, k = self.turn(self.q_norm(q)), self.turn(self.k_norm(k))
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).reshape(batch, tokens, c)
        x = x + self.gammas[0] * self.proj(mixed)
        return x + self.gammas[1] * self.fc2(F.gelu(self.fc1(self.norm2(x))))


def rotary(frames):
    """Cosines and signed sines. `[tokens, head size]` each"""
    quarter, special = WIDTH // HEADS // 4, job["registers"] + 3
    rows = [0] * special + [r + 1 for r in range(GRID[0]) for _ in range(GRID[1])]
    columns = [0] * special + [c + 1 for _ in range(GRID[0]) for c in range(GRID[1])]
    frequencies = 100.0 ** (-torch.arange(quarter) / quarter)
    down, across = (torch.tensor(p * frames)[:, None] * frequencies for p in (rows, columns))
    cosine = torch.cat([down.cos(), down.cos(), across.cos(), across.cos()], -1)
    return cosine, torch.cat([-down.sin(), down.sin(), -across.sin(), across.sin()], -1)


class Encoder(nn.Module):
    def __init__(self):
        super().__init__()
        patch, side, registers = job["patch"], job["position_grid"], job["registers"]
        self.project = nn.Conv2d(3, WIDTH, patch, patch)
        self.special = nn.Parameter(torch.randn(1, 1 + registers, WIDTH) * 0.02)
        self.positions = nn.Parameter(torch.randn(1, WIDTH, side, side) * 0.02)
        self.blocks = nn.ModuleList([Block(None) for _ in range(job["encoder_blocks"])])
        self.norm = nn.LayerNorm(WIDTH)

    def forward(self, images):
        tokens = self.project(images).flatten(2).transpose(1, 2)
        table = F.interpolate(self.positions, size=tuple(GRID), mode="bicubic", antialias=True)
        tokens = torch.cat([self.special.expand(len(images), -1, -1), tokens + table.flatten(2).transpose(1, 2)], 1)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)[:, -PATCHES:]


class Sweep(nn.Module):
    """Similarities along rays, and the network that reads them."""

    def __init__(self):
        super().__init__()
        inputs = [12, 4 * ENCODER[0], 4 * ENCODER[1]]
        self.levels = nn.ModuleList([TwoLayers(i, o) for i, o in zip(inputs, ENCODER)])
        self.features = nn.ModuleList([conv(c, SWEPT) for c in ENCODER])
        first = (GROUPS + 1) * DEPTHS + ENCODER[1] + RAYS
        self.down = nn.ModuleList(
            [TwoLayers(first, DECODER[0]), TwoLayers(DECODER[0], DECODER[1]), TwoLayers(DECODER[1], DECODER[2])]
        )
        self.up = nn.ModuleList(
            [TwoLayers(DECODER[1] + DECODER[0], DECODER[0]), TwoLayers(DECODER[2] + DECODER[1], DECODER[1])]
        )
        self.depths = conv(DECODER[0], DEPTHS, 1)

    def similarity(self, map):
        size = [-(-side // 2) for side in map.shape[2:]]
        own = F.avg_pool2d(map, 2, ceil_mode=True).reshape(IMAGES, SWEPT, -1)
        there = F.grid_sample(map[PARTNERS], POINTS, padding_mode="border", align_corners=False)
        products = own[OWNERS][:, :, None] * there
        sums = products.view(len(PARTNERS), GROUPS, SWEPT // GROUPS, DEPTHS, -1).sum(2)
        return sums.view(IMAGES, -1, GROUPS, DEPTHS, *size).mean(1)

    def forward(self, images):
        seen = [self.levels[0](cells(images))]
        for level in (1, 2):
            seen.append(self.levels[level](cells(seen[-1])))
        fine, middle, coarse = (conv(map) for conv, map in zip(self.features, seen))
        middle = middle + resized(coarse, middle.shape[2:])
        map = fine + resized(middle, fine.shape[2:])
        map = map - map.mean((2, 3), keepdim=True)
        map = map / (map.square().sum(1, keepdim=True) + 1e-6).sqrt()
        similarity = self.similarity(map)
        cosine = similarity.sum(1)
        matches = F.log_softmax(cosine * 16 - UNSEEN * 8, 1)
        first = self.down[0](torch.cat([2 * similarity.flatten(1, 2), VISIBLE, seen[1], CELL_RAYS], 1))
        half = [-(-side // 2) for side in first.shape[2:]]
        second = self.down[1](resized(first, half))
        third = self.down[2](resized(second, [-(-side // 2) for side in half]))
        second = self.up[1](torch.cat([resized(third, half), second], 1))
        hidden = self.up[0](torch.cat([resized(second, first.shape[2:]), first], 1))
        likely = F.log_softmax(self.depths(hidden) + cosine * 8, 1)
        chances = likely.exp()
        log_depth = (chances * LOG_DEPTHS).sum(1, keepdim=True)
        said = torch.cat([hidden, log_depth, chances.square().sum(1, keepdim=True)], 1)
        return matches, likely, log_depth, said


class ResidualUnit(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second = conv(FEATURES, FEATURES), conv(FEATURES, FEATURES)

    def forward(self, x):
        x = F.relu(x)
        return self.second(F.relu(self.first(x))) + x


class Head(nn.Module):
    """Four token maps to one map at image size."""

    def __init__(self, outputs, timed, shortcut):
        super().__init__()
        channels, stems = job["head_channels"], job["stem_channels"]
        self.norm = nn.LayerNorm(2 * WIDTH)
        self.time = nn.Linear(2 * job["time_frequencies"], 4 * WIDTH) if timed else None
        self.projects = nn.ModuleList([nn.Linear(2 * WIDTH, c) for c in channels])
        self.enlarge = nn.ModuleList(
            [nn.ConvTranspose2d(channels[0], channels[0], 4, 4), nn.ConvTranspose2d(channels[1], channels[1], 2, 2)]
        )
        self.shrink = conv(channels[3], channels[3], 3, 2)
        self.reduce = nn.ModuleList([nn.Conv2d(c, FEATURES, 3, 1, 1, bias=False) for c in channels])
        self.lateral = nn.ModuleList([ResidualUnit() for _ in range(3)])
        self.units = nn.ModuleList([ResidualUnit() for _ in range(4)])
        self.outs = nn.ModuleList([conv(FEATURES, FEATURES, 1) for _ in range(4)])
        self.stem = None
        if not timed:
            self.stem = nn.ModuleList([conv(c, FEATURES, 1) for c in stems])
            self.join = nn.ModuleList([conv(FEATURES, FEATURES), conv(FEATURES, FEATURES)])
        self.narrow = conv(FEATURES, FEATURES // 2)
        self.tail = nn.ModuleList([conv(FEATURES // 2, HIDDEN), conv(HIDDEN, outputs, 1)])
        self.short = nn.ModuleList([conv(shortcut, HIDDEN), conv(HIDDEN, outputs, 1)]) if shortcut else None

    def forward(self, taps, stem):
        modulation = self.time(TIME).chunk(2, -1) if self.time else None
        levels = []
        for level, tokens in enumerate(taps):
            tokens = tokens * self.norm.weight + self.norm.bias
            if modulation:
                tokens = tokens * (1 + modulation[0]) + modulation[1]
            x = self.projects[level](tokens).transpose(1, 2).reshape(IMAGES, -1, *GRID)
            x = (x + POSITIONS[level]).contiguous(memory_format=FORMAT)
            if level < 2:
                x = self.enlarge[level](x)
            elif level == 3:
                x = self.shrink(x)
            x = self.reduce[level](x)
            if self.stem and level < 3:
                x = x + resized(self.stem[level + 1](stem[level + 1]), x.shape[2:])
            levels.append(x)
        y = None
        for level in (3, 2, 1, 0):
            x = levels[level]
            if y is not None:
                x = y + self.lateral[level](x)
            size = levels[level - 1].shape[2:] if level else [2 * side for side in x.shape[2:]]
            # The 1x1 convolution commutes with the resampling.
            y = resized(self.outs[level](self.units[level](x)), size)
        if self.stem:
            y = y + resized(self.stem[0](stem[0]), y.shape[2:])
            y = y + self.join[1](F.relu(self.join[0](F.relu(y))))
        y = resized(self.narrow(y), SIZE) + POSITIONS[4]
        return self.tail[1](F.relu(self.tail[0](y)))

    def shortcut(self, x):
        return self.short[1](F.relu(self.short[0](x)))


class Network(nn.Module):
    def __init__(self):
        super().__init__()
        stems = job["stem_channels"]
        inputs = [36] + [4 * c for c in stems[:3]]
        self.encoder = Encoder()
        self.stem = nn.ModuleList([TwoLayers(i, o) for i, o in zip(inputs, stems)])
        self.sweep, self.join = Sweep(), conv(DECODER[0] + 2, stems[1])
        self.stem_tokens = nn.Linear(stems[2] + stems[3], WIDTH)
        self.rays = nn.Linear(6 * job["patch"] ** 2, WIDTH)
        self.ray_norm = nn.GroupNorm(1, WIDTH)
        self.time, self.pose = nn.Linear(2 * job["time_frequencies"], WIDTH), nn.Linear(9, WIDTH)
        self.special = nn.Parameter(torch.randn(1, FRAMES, 1 + job["registers"], WIDTH) * 0.02)
        self.frame_blocks = nn.ModuleList([Block(rotary(1)) for _ in range(job["pairs"])])
        self.global_blocks = nn.ModuleList([Block(rotary(FRAMES)) for _ in range(job["pairs"])])
        self.depth, self.splat = Head(2, False, 0), Head(12, False, 3)
        self.motion, self.timed = Head(4, True, 0), Head(12, True, 11)
        hidden = job["fk_hidden"]
        self.branch = nn.ModuleList([conv(7, hidden), conv(hidden, hidden), conv(hidden, 3)])

    def forward(self, images):
        matches, likely, log_swept, said = self.sweep(images)
        levels, map = [], torch.cat([images, RAY_MAPS], 1)
        for level, layers in enumerate(self.stem):
            map = layers(cells(map))
            if level == 1:
                map = map + self.join(said)
            levels.append(map)
        stem = torch.cat([resized(level, GRID) for level in levels[2:]], 1).flatten(2).transpose(1, 2)
        tokens = self.encoder(images) + self.stem_tokens(stem)
        rays = self.rays(RAY_PATCHES).view(CLIPS, FRAMES * PATCHES, WIDTH).transpose(1, 2)
        tokens = tokens + self.ray_norm(rays).transpose(1, 2).reshape(IMAGES, PATCHES, WIDTH)
        numbers = torch.stack([self.time(TIMES), self.pose(POSES)], 1)
        special = self.special.expand(CLIPS, -1, -1, -1).reshape(IMAGES, -1, WIDTH)
        tokens, taps = torch.cat([numbers, special, tokens], 1), []
        for frame, joint in zip(self.frame_blocks, self.global_blocks):
            inner = frame(tokens)
            tokens = joint(inner.view(CLIPS, -1, WIDTH)).view(inner.shape)
            taps.append(F.layer_norm(torch.cat([inner, tokens], -1)[:, -PATCHES:], (2 * WIDTH,)))
        log_depth = self.depth(taps, levels)[:, 0]
        base = self.splat(taps, levels) + self.splat.shortcut(images)
        branch = KAPPA
        for layer in self.branch[:2]:
            branch = F.relu(layer(branch))
        displacement = self.motion(taps, levels)[:, :3] + self.branch[2](branch)
        timed = self.timed(taps, levels) + self.timed.shortcut(base[:, :11])
        gate = displacement.detach().square().sum(1, keepdim=True) > 1e-4
        return matches, likely, log_swept, log_depth, displacement, torch.where(gate, timed, base)


def mean(values, mask):
    return (values * mask).sum() / (mask.sum() + 1e-6)


def depth_loss(depth):
    error, mask = (depth - DEPTH) * VALID, VALID
    loss = error.square().sum() / (mask.sum() + 1e-6)
    for scale in range(4):
        if scale:
            error, mask = error[:, ::2, ::2], mask[:, ::2, ::2]
        across = ((error[:, :, 1:] - error[:, :, :-1]).abs() * mask[:, :, 1:] * mask[:, :, :-1]).sum()
        down = ((error[:, 1:] - error[:, :-1]).abs() * mask[:, 1:] * mask[:, :-1]).sum()
        loss = loss + (across + down) / (mask.sum() + 1e-6) / 4
    return loss


def objective(matches, likely, log_swept, log_depth, displacement, raw):
    error = (log_depth - DEPTH.log()).abs()
    loss = mean(error, VALID) + mean(error, ROBOT[:, 0]) + depth_loss(log_depth.exp().clamp(0.001, 100))
    known = VALID_CELLS
    for chances in (matches, likely):
        loss = loss - mean((chances * CELL_DEPTHS).sum(1, keepdim=True), known)
    loss = loss + mean((log_swept - CELL_LOGS).abs(), known)
    rows = displacement.permute(0, 2, 3, 1).reshape(CLIPS, -1, 3)
    picked, wanted = rows[:, TRACKS], MOVED[:, TRACKS]
    products = picked @ picked.mT - wanted @ wanted.mT
    loss = loss + (picked - wanted).abs().mean() + 10 * products.abs().mean()
    loss = loss + mean((rows - MOVED).abs(), ROBOT.permute(0, 2, 3, 1).reshape(CLIPS, -1, 1)) / 3
    # What the rasteriser sends back: some slope for every attribute.
    activated = [raw[:, :3].tanh(), F.softplus(raw[:, 3:6]), F.normalize(raw[:, 6:10], dim=1), raw[:, 10:11].tanh()]
    return loss + (torch.cat(activated, 1) * SLOPES).sum()


def head_positions(channels, rows, columns):
    return 0.1 * torch.randn(1, channels, rows, columns)


def feature_map(*shape):
    return torch.randn(*shape).contiguous(memory_format=FORMAT)


half = [-(-side // 2) for side in SIZE]
quarter = [-(-side // 2) for side in half]
CELLS = quarter[0] * quarter[1]
times = FRAMES // job["cameras"]
pairs = [
    (clip * FRAMES + a * times + t, clip * FRAMES + b * times + t)
    for clip in range(CLIPS)
    for a in range(job["cameras"])
    for t in range(times)
    for b in range(job["cameras"])
    if a != b
]
OWNERS, PARTNERS = (torch.tensor(side) for side in zip(*pairs))
# Rays of neighbouring cells stay neighbours in the other image, as those of real cameras do.
steps = torch.linspace(-0.8, 0.8, DEPTHS)[:, None]
across = torch.linspace(-1, 1, quarter[1]).repeat(quarter[0])
down = torch.linspace(-1, 1, quarter[0]).repeat_interleave(quarter[1])
points = torch.stack([0.8 * across + steps, 0.8 * down + 0.3 * steps], -1)
POINTS = points.expand(len(pairs), -1, -1, -1).contiguous()
UNSEEN = torch.zeros(IMAGES, DEPTHS, *quarter)
VISIBLE = feature_map(IMAGES, DEPTHS, *quarter)
CELL_RAYS = feature_map(IMAGES, RAYS, *quarter)
LOG_DEPTHS = torch.linspace(-2, 1.4, DEPTHS).view(1, -1, 1, 1)
TIME = torch.randn(2 * job["time_frequencies"])
TIMES, POSES = torch.randn(IMAGES, 2 * job["time_frequencies"]), torch.randn(IMAGES, 9)
IMAGE_MAPS, RAY_MAPS = feature_map(IMAGES, 3, *SIZE), feature_map(IMAGES, 6, *SIZE)
RAY_PATCHES = torch.randn(IMAGES, PATCHES, 6 * job["patch"] ** 2)
KAPPA = feature_map(IMAGES, 7, *SIZE)
c = job["head_channels"]
POSITIONS = [head_positions(channels, *GRID) for channels in c] + [head_positions(FEATURES // 2, *SIZE)]
DEPTH, VALID = torch.rand(IMAGES, *SIZE) * 4 + 0.5, torch.ones(IMAGES, *SIZE)
ROBOT = (torch.rand(IMAGES, 1, *SIZE) < 0.1).float()
MOVED = torch.randn(CLIPS, FRAMES * SIZE[0] * SIZE[1], 3) * 0.1
TRACKS = torch.randperm(FRAMES * SIZE[0] * SIZE[1])[:1000]
CELL_DEPTHS = torch.softmax(torch.randn(IMAGES, DEPTHS, *quarter), 1)
CELL_LOGS, VALID_CELLS = torch.randn(IMAGES, 1, *quarter), torch.ones(IMAGES, 1, *quarter)
SLOPES = torch.randn(IMAGES, 11, *SIZE) * 1e-5

network = Network().to(memory_format=FORMAT)
parameters = list(network.parameters())
optimiser = torch.optim.AdamW(parameters, 1e-4, (0.9, 0.95), weight_decay=0.05, fused=True)


def timed(work):
    wall, processor = time.perf_counter(), time.process_time()
    result = work()
    return result, [time.perf_counter() - wall, time.process_time() - processor]


def step():
    torch.nn.utils.clip_grad_norm_(parameters, 1.0)
    optimiser.step()
    optimiser.zero_grad()


for _ in sys.stdin:
    loss, forward = timed(lambda: objective(*network(IMAGE_MAPS)))
    _, backward = timed(loss.backward)
    _, moved = timed(step)
    print(json.dumps({"forward": forward, "backward": backward, "optimiser": moved}), flush=True)
    del loss
