"""Train the small depth network behind ``--depth rooms-net`` on built-in rooms, and export it to ONNX.

    python scripts/train_rooms_net.py make  FOLDER --rooms 160     # renders the training views; may be stopped
    python scripts/train_rooms_net.py train FOLDER --steps 3000    # may start while ``make`` still runs
    python scripts/train_rooms_net.py export FOLDER OUT.onnx       # float16 weights, float32 arithmetic

``make`` writes one file per room, room k from seed k alone, and skips those that are there; ``train`` draws only from
rooms that its schedule has released, and waits for them. So the result depends on the seed, the number of rooms and
the steps, not on which process was faster. The network gets a panorama of 128x64 and answers log radial distance up
to scale.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

WIDTH, HEIGHT = 128, 64
VIEWS = 32
#: Kinds in the order they are built; flats cost three times as much as single rooms.
KINDS = ("room1", "room3", "room5", "room4", "room1", "room2", "room5", "room3", "tiny", "loop")
FIRST_SEED = 10_000  # far from the seeds that sequences use
TEST_ROOMS = 8  # the first rooms are for validation only
#: Rooms released at the start, and steps between two further ones.
EARLY_ROOMS, RELEASE = 24, 12


# -- data --------------------------------------------------------------------------------------------------------


def make_room(k: int) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
    """Images (V, H, W, 3) and log radial distance (V, H, W) of room k from VIEWS random places in it."""
    from panobench.cameras.erp import ErpCamera
    from panobench.rooms import motion, render
    from panobench.rooms.world import World

    rng = np.random.default_rng([FIRST_SEED, k])
    world = World(KINDS[k % len(KINDS)], FIRST_SEED + k, None)
    bundle = render.ray_bundle(ErpCamera(WIDTH, HEIGHT))
    near = world.path.T_wc.copy()
    near[:, 2, 3] += rng.uniform(-0.4, 0.3, len(near))
    T = motion.novel_poses(near, world.geometry.mesh, rng, VIEWS, 0.25)
    lean = np.where(rng.uniform(size=VIEWS) < 0.2, 0.25, 0.05)
    tilt = rng.normal(size=(2, VIEWS)) * lean
    T[:, :3, :3] = motion.rotations(rng.uniform(0, 2 * np.pi, VIEWS), *tilt)
    images, depths = [], []
    for pose in T:
        gain = world.path.exposure * 2.0 ** rng.normal(0, 0.5)
        linear = render.radiance(world.scene, bundle, pose, gain=gain, sub=3)
        linear *= np.exp(rng.normal(0, 0.08, 3)).astype(np.float32)
        linear = np.clip(linear, 0, 1) ** np.float32(np.exp(rng.normal(0, 0.15)))
        images.append(render.to_image(linear, sigma=rng.uniform(0, 0.02), seed=int(rng.integers(1 << 30))))
        depths.append(np.log(render.depth(world.geometry, bundle, pose)))
    return np.stack(images), np.stack(depths).astype(np.float16)


def make(folder: Path, rooms: int) -> None:
    """Render rooms 0 .. rooms-1 into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        os.environ["PANOBENCH_CACHE"] = scratch
        for k in range(rooms):
            path = folder / f"room{k:05d}.npz"
            if path.is_file():
                continue
            images, depths = make_room(k)
            part = path.with_suffix(".part")
            with part.open("wb") as file:
                np.savez(file, images=images, depths=depths)
            part.rename(path)
            print(f"room {k + 1} of {rooms}", flush=True)


@dataclass
class Pool:
    """Views of the rooms read so far: images (N, 3, H, W) uint8 and log distances (N, H, W) float16."""

    folder: Path
    images: Tensor
    depths: Tensor
    next_room: int

    @classmethod
    def empty(cls, folder: Path, first: int) -> Pool:
        images = torch.empty((0, 3, HEIGHT, WIDTH), dtype=torch.uint8)
        return cls(folder, images, torch.empty((0, HEIGHT, WIDTH), dtype=torch.float16), first)

    def grow(self, rooms: int) -> None:
        """Read up to room ``rooms`` - 1, waiting for those that are still being made."""
        images, depths = [self.images], [self.depths]
        while self.next_room < rooms:
            path = self.folder / f"room{self.next_room:05d}.npz"
            while not path.is_file():
                time.sleep(2)
            with np.load(path) as data:
                images.append(torch.from_numpy(data["images"].transpose(0, 3, 1, 2).copy()))
                depths.append(torch.from_numpy(data["depths"]))
            self.next_room += 1
        if len(images) > 1:
            self.images, self.depths = torch.cat(images), torch.cat(depths)

    def batch(self, size: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Random views, turned about the vertical and mirrored: both are exact on a panorama."""
        chosen = torch.randint(len(self.images), (size,), generator=rng)
        turn = torch.randint(WIDTH, (size,), generator=rng).tolist()
        mirror = torch.rand(size, generator=rng).tolist()
        x, y = [], []
        for i, shift, m in zip(chosen.tolist(), turn, mirror):
            image, depth = self.images[i].roll(shift, -1), self.depths[i].roll(shift, -1)
            x.append(image.flip(-1) if m < 0.5 else image)
            y.append(depth.flip(-1) if m < 0.5 else depth)
        return torch.stack(x).float() / 255.0, torch.stack(y).float()


# -- network -----------------------------------------------------------------------------------------------------


class Block(nn.Module):
    """Two 3x3 convolutions; the image wraps round in longitude and is repeated beyond the poles."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, bias=False)
        self.second = nn.Conv2d(outputs, outputs, 3, bias=False)
        self.norm1, self.norm2 = nn.GroupNorm(8, outputs), nn.GroupNorm(8, outputs)

    def forward(self, x: Tensor) -> Tensor:
        x = F.relu(self.norm1(self.first(_pad(x))))
        return F.relu(self.norm2(self.second(_pad(x))))


def _pad(x: Tensor) -> Tensor:
    x = torch.cat([x[..., -1:], x, x[..., :1]], dim=-1)
    return torch.cat([x[..., :1, :], x, x[..., -1:, :]], dim=-2)


class RoomsNet(nn.Module):
    """U-Net: RGB (N, 3, 64, 128) in 0..1 to log radial distance (N, 1, 64, 128). Latitude is a fourth channel."""

    CHANNELS = (16, 32, 64, 128, 192)

    def __init__(self) -> None:
        super().__init__()
        c = self.CHANNELS
        self.down = nn.ModuleList(Block(i, o) for i, o in zip((4, *c), c))
        self.up = nn.ModuleList(Block(a + b, b) for a, b in zip(c[:0:-1], c[-2::-1]))
        self.head = nn.Conv2d(c[0], 1, 1)
        lat = (0.5 - (torch.arange(HEIGHT) + 0.5) / HEIGHT) * torch.pi
        self.register_buffer("latitude", torch.sin(lat)[None, None, :, None].expand(1, 1, HEIGHT, WIDTH).clone())

    def forward(self, x: Tensor) -> Tensor:
        x = torch.cat([(x - 0.45) / 0.27, self.latitude.expand(x.shape[0], -1, -1, -1)], dim=1)
        kept = []
        for k, block in enumerate(self.down):
            x = block(x if k == 0 else F.avg_pool2d(x, 2))
            kept.append(x)
        for block, skip in zip(self.up, kept[-2::-1]):
            x = block(torch.cat([F.interpolate(x, scale_factor=2.0, mode="nearest"), skip], dim=1))
        return self.head(x) + 0.7


# -- training ----------------------------------------------------------------------------------------------------


def loss_of(answer: Tensor, truth: Tensor) -> Tensor:
    """Absolute error of the log distance after removing its mean (Eigen et al. 2014, weight one, as L1), weighted by
    solid angle; that of its differences at four scales (Li & Snavely 2018), which sharpens edges; a little of the mean.
    """
    known = torch.isfinite(truth)
    lat = (0.5 - (torch.arange(truth.shape[-2]) + 0.5) / truth.shape[-2]) * torch.pi
    w = torch.cos(lat)[None, :, None] * known
    error = torch.where(known, answer - torch.nan_to_num(truth), torch.zeros(()))
    total = w.sum((1, 2))
    mean = (w * error).sum((1, 2)) / total
    e = (error - mean[:, None, None]) * known
    loss = ((w * e.abs()).sum((1, 2)) / total).mean() + 0.05 * mean.abs().mean()
    for _ in range(4):
        across = (e.roll(-1, -1) - e).abs()
        down = (e[:, 1:] - e[:, :-1]).abs()
        loss = loss + 0.125 * ((w * across).sum() / w.sum() + (w[:, 1:] * down).sum() / w[:, 1:].sum())
        e, w = F.avg_pool2d(e, 2), F.avg_pool2d(w, 2)
    return loss


@torch.no_grad()
def median_error(net: RoomsNet, pool: Pool) -> tuple[float, float]:
    """Median relative error after scale alignment by the median, of the network and of a constant; mean over views."""
    ours, constant = [], []
    for i in range(0, len(pool.images), VIEWS):
        truth = pool.depths[i : i + VIEWS].float().exp()
        answer = net(pool.images[i : i + VIEWS].float() / 255.0)[:, 0].exp()
        for a, t in zip(answer, truth):
            for found, ratio in ((ours, a / t), (constant, 1 / t)):
                ratio = ratio[torch.isfinite(ratio)]
                found.append(float((ratio / ratio.median() - 1).abs().median()))
    return float(np.mean(ours)), float(np.mean(constant))


def train(folder: Path, rooms: int, steps: int, batch: int, rate: float, seed: int, half: bool) -> None:
    """Writes FOLDER/rooms-net.pt and FOLDER/train.log. ``half``: activations in bfloat16, twice as fast where the
    processor has it.
    """
    torch.manual_seed(seed)
    rng = torch.Generator().manual_seed(seed)
    net = RoomsNet()
    print(f"{sum(p.numel() for p in net.parameters())} parameters", flush=True)
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps, pct_start=0.05)
    test, pool = Pool.empty(folder, 0), Pool.empty(folder, TEST_ROOMS)
    test.grow(TEST_ROOMS)
    begin, total = time.monotonic(), 0.0
    with (folder / "train.log").open("w", encoding="utf-8") as log:
        for step in range(1, steps + 1):
            pool.grow(min(rooms, TEST_ROOMS + EARLY_ROOMS + step // RELEASE))
            images, truth = pool.batch(batch, rng)
            with torch.autocast("cpu", torch.bfloat16, enabled=half):
                answer = net(images)[:, 0]
            loss = loss_of(answer.float(), truth)
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            total += float(loss.detach())
            if step % 100 == 0 or step == steps:
                ours, constant = median_error(net, test)
                torch.save(net.state_dict(), folder / "rooms-net.pt")
                line = (
                    f"step {step} loss {total / (step % 100 or 100):.4f} rooms {pool.next_room - TEST_ROOMS} "
                    f"median error {ours:.4f} constant {constant:.4f} seconds {time.monotonic() - begin:.0f}"
                )
                print(line, flush=True)
                print(line, file=log, flush=True)
                total = 0.0


# -- export ------------------------------------------------------------------------------------------------------


def export(folder: Path, out: Path) -> None:
    """ONNX with weights stored as float16 and cast on loading: half the size, float32 arithmetic."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    net = RoomsNet().eval()
    net.load_state_dict(torch.load(folder / "rooms-net.pt", weights_only=True))
    torch.onnx.export(
        net, (torch.zeros(1, 3, HEIGHT, WIDTH),), str(out), input_names=["image"], output_names=["log_distance"],
        opset_version=17, dynamo=False,
    )  # fmt: skip
    model = onnx.load(str(out))
    graph, casts = model.graph, []
    for tensor in graph.initializer:
        if tensor.data_type == TensorProto.FLOAT and np.prod(tensor.dims) > 256:
            name = tensor.name
            small = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), name + "_half")
            tensor.CopyFrom(small)
            casts.append(helper.make_node("Cast", [name + "_half"], [name], to=TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)
    del model.metadata_props[:]
    for node in graph.node:
        node.doc_string = ""
    onnx.checker.check_model(model)
    onnx.save(model, str(out))
    print(f"{out}: {out.stat().st_size} bytes")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("make", "train", "export"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path, nargs="?")
    parser.add_argument("--rooms", type=int, default=160)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--batch", type=int, default=12)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bf16", action="store_true")
    a = parser.parse_args()
    if a.what == "make":
        make(a.folder, a.rooms)
    elif a.what == "train":
        train(a.folder, a.rooms, a.steps, a.batch, a.rate, a.seed, a.bf16)
    else:
        export(a.folder, a.out or a.folder / "rooms-net.onnx")


if __name__ == "__main__":
    main()
