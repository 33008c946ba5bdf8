#!/usr/bin/env python3
"""Runs the shapes of `udc bench` in PyTorch too and prints both times and their ratio, in one run.

    python benches/compare_pytorch.py [--udc target/release/udc] [--threads 2] [--seconds 0.5] [--only TEXT]
                                      [--simd avx2]

PyTorch must be installed; nothing else is needed. Times are the best of several calls. The dynamic filter
is timed as it is usually written (filters stored, features unfolded), and so is training. The whole network is
timed in three ways of writing it: planar and with such filters, as the method was published; tuned, with channels
innermost and the stored filters applied tap by tap, features not unfolded; and tuned for memory too, with the filters
of one tap made at a time. The tuned ones are timed in bfloat16 as well, with which udc's own bfloat16 products are
compared where the CPU has them. With --simd both programs use no more than these vector instructions.
"""

import argparse
import os
import re
import subprocess
import sys
import time

try:
    import torch
    import torch.nn.functional as F
except ModuleNotFoundError:
    sys.exit("PyTorch is not installed: `pip install torch`, then run this again")

SIZE = 5  # of the dynamic filters
SLOPE = 0.2


def best(call, seconds):
    call()
    begun, shortest = time.perf_counter(), float("inf")
    while time.perf_counter() - begun < seconds or shortest == float("inf"):
        start = time.perf_counter()
        call()
        shortest = min(shortest, time.perf_counter() - start)
    return shortest


def tensor(*shape):
    return torch.randn(*shape).contiguous(memory_format=torch.channels_last)


def convolution(inputs, outputs, side, stride=1):
    x, weight, bias = tensor(1, inputs, side, side), tensor(outputs, inputs, 3, 3), torch.randn(outputs)
    return lambda: F.leaky_relu(F.conv2d(x, weight, bias, stride, 1), SLOPE)


def convolution_gradient(inputs, outputs, images, side, stride, wanted):
    x = tensor(images, inputs, side, side).requires_grad_(wanted == "input")
    weight = tensor(outputs, inputs, 3, 3).requires_grad_(wanted == "weights")
    output = F.conv2d(x, weight, None, stride, 1)
    gradient = torch.randn_like(output)
    target = x if wanted == "input" else weight
    return lambda: torch.autograd.grad(output, target, gradient, retain_graph=True)


def up(inputs, channels, side):
    x, skip = tensor(1, inputs, side, side), tensor(1, channels, 2 * side, 2 * side)
    weight, bias = tensor(4 * channels, inputs, 3, 3), torch.randn(4 * channels)
    return lambda: F.leaky_relu(F.pixel_shuffle(F.conv2d(x, weight, bias, 1, 1), 2), SLOPE) + skip


def apply_filter(condition, features, weight, bias, slope):
    items, channels, height, width = features.shape
    filters = F.prelu(F.conv2d(condition, weight, bias), slope)
    filters = filters.view(items, channels, SIZE * SIZE, height, width)
    padded = F.pad(features, [SIZE // 2] * 4, mode="replicate")
    windows = F.unfold(padded, SIZE).view(items, channels, SIZE * SIZE, height, width)
    return (filters * windows).sum(2)


def add_taps(features, filters_of):
    """The sum over the taps of shifted features times the tap's filters."""
    height, width = features.shape[2:]
    padded = F.pad(features, [SIZE // 2] * 4, mode="replicate").contiguous(memory_format=torch.channels_last)
    result = torch.zeros_like(features)
    for tap in range(SIZE * SIZE):
        y, x = divmod(tap, SIZE)
        result.addcmul_(filters_of(tap), padded[:, :, y : y + height, x : x + width])
    return result


def apply_filter_by_taps(condition, features, weight, bias, slope):
    filters = F.prelu(F.conv2d(condition, weight, bias), slope)
    return add_taps(features, lambda tap: filters[:, tap :: SIZE * SIZE])


def make_filter_by_taps(condition, features, weight, bias, slope):
    def filters_of(tap):
        of_tap = slice(tap, None, SIZE * SIZE)
        return F.prelu(F.conv2d(condition, weight[of_tap], bias[of_tap]), slope)

    return add_taps(features, filters_of)


def dynamic_filter(channels, images, side, with_gradient):
    condition, features = tensor(images, channels, side, side), tensor(images, channels, side, side)
    weight = torch.randn(channels * SIZE * SIZE, channels, 1, 1)
    bias, slope = torch.randn(channels * SIZE * SIZE), torch.tensor([SLOPE])
    if not with_gradient:
        return lambda: apply_filter(condition, features, weight, bias, slope)
    inputs = [t.requires_grad_() for t in (condition, features, weight, bias, slope)]
    output = apply_filter(*inputs)
    gradient = torch.randn_like(output)
    return lambda: torch.autograd.grad(output, inputs, gradient, retain_graph=True)


class Layers(torch.nn.Module):
    """DISCNet with n = 32 channels, image and code as conditions, filters at three scales."""

    def __init__(self, n=32, code=5, apply=apply_filter):
        super().__init__()
        self.apply_filter = apply
        self.encoders = torch.nn.ModuleList(self.encoder(i, n) for i in (3, 3 + code))
        self.generators = torch.nn.ModuleList(self.generator(n << k) for k in range(3))
        self.ups = torch.nn.ModuleList(torch.nn.Conv2d(n << (k + 1), 4 * (n << k), 3, 1, 1) for k in range(2))
        self.refine = torch.nn.ModuleList(self.residuals(n << k) for k in range(2))
        self.last = torch.nn.Conv2d(n, 3, 3, 1, 1)

    @staticmethod
    def residuals(channels):
        return torch.nn.ModuleList(torch.nn.Conv2d(channels, channels, 3, 1, 1) for _ in range(4))

    def encoder(self, inputs, n):
        scale = lambda i, k: torch.nn.Conv2d(i, n << k, 3, 1 if k == 0 else 2, 1)
        inputs = [inputs, n, 2 * n]
        return torch.nn.ModuleList(
            torch.nn.ModuleList([scale(inputs[k], k), self.residuals(n << k)]) for k in range(3)
        )

    def generator(self, channels):
        first, head = torch.nn.Conv2d(channels, channels, 3, 1, 1), torch.nn.Conv2d(channels, 25 * channels, 1)
        slopes = torch.nn.PReLU(init=SLOPE), torch.nn.PReLU(init=SLOPE)
        return torch.nn.ModuleList([first, slopes[0], self.residuals(channels), head, slopes[1]])

    @staticmethod
    def refined(x, layers):
        for first, second in zip(layers[::2], layers[1::2]):
            x = x + second(F.leaky_relu(first(x), SLOPE))
        return x

    def encode(self, encoder, x):
        features = []
        for convolution, residuals in encoder:
            x = self.refined(F.leaky_relu(convolution(x), SLOPE), residuals)
            features.append(x)
        return features

    def forward(self, image, code):
        features = self.encode(self.encoders[0], image)
        conditions = self.encode(self.encoders[1], torch.cat([code, image], 1))
        skips = []
        for feature, condition, (first, slope, residuals, head, last) in zip(
            features, conditions, self.generators
        ):
            condition = self.refined(slope(first(condition)), residuals)
            skips.append(self.apply_filter(condition, feature, head.weight, head.bias, last.weight))
        x = skips[2]
        for k in (1, 0):
            x = F.leaky_relu(F.pixel_shuffle(self.ups[k](x), 2), SLOPE) + skips[k]
            x = self.refined(x, self.refine[k])
        return F.leaky_relu(self.last(x), SLOPE) + image


def network(side, memory, kind, apply):
    to = dict(memory_format=memory, dtype=kind)
    layers = Layers(apply=apply).to(**to)
    image, code = (torch.randn(1, channels, side, side).to(**to) for channels in (3, 5))
    return lambda: layers(image, code)


def networks(side, rounded):
    """The whole network in each way of writing it; in bfloat16 only, when rounded."""
    last = torch.channels_last
    if not rounded:
        yield "as published", network(side, torch.contiguous_format, torch.float32, apply_filter)
        yield "tuned", network(side, last, torch.float32, apply_filter_by_taps)
        yield "filters not stored", network(side, last, torch.float32, make_filter_by_taps)
    yield "tuned, bfloat16", network(side, last, torch.bfloat16, apply_filter_by_taps)
    yield "filters not stored, bfloat16", network(side, last, torch.bfloat16, make_filter_by_taps)


def training_step(images, side):
    layers = Layers().to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(layers.parameters(), lr=2e-4)
    image, code, clean = tensor(images, 3, side, side), tensor(images, 5, side, side), tensor(images, 3, side, side)

    def step():
        optimizer.zero_grad()
        F.l1_loss(layers(image, code), clean).backward()
        optimizer.step()

    return step


def in_pytorch(name):
    """What does in PyTorch what a line of `udc bench` names: calls, each with the way in which it is written."""
    numbers = [int(number) for number in re.findall(r"\d+", name.replace("3×3", "").replace("²", ""))]
    if name.startswith("network"):
        return networks(numbers[0], "bf16" in name)
    if name.startswith("training step"):
        return [("", training_step(*numbers))]
    if name.startswith("up"):
        return [("", up(*numbers))]
    if name.startswith("dynamic filter"):
        channels, *rest = numbers
        images, side = rest if len(rest) == 2 else (1, rest[0])
        return [("", dynamic_filter(channels, images, side, "backward" in name))]
    stride = 2 if "stride 2" in name else 1
    if "stride 2" in name:
        numbers.remove(2)
    for wanted in ("input", "weights"):
        if f"to {wanted}" in name:
            inputs, outputs, images, side = numbers
            return [("", convolution_gradient(inputs, outputs, images, side, stride, wanted))]
    inputs, outputs, side = numbers
    return [("", convolution(inputs, outputs, side, stride))]


def limit_instructions(simd):
    """Starts this program again with the variables that udc, PyTorch, oneDNN and MKL read when they are loaded."""
    names = {"avx2": ("avx2", "AVX2", "AVX2"), "avx512": ("avx512", "AVX512_CORE", "AVX512")}
    if simd is None or os.environ.get("UDC_SIMD") == simd:
        return
    aten, onednn, mkl = names[simd]
    limits = {"ATEN_CPU_CAPABILITY": aten, "ONEDNN_MAX_CPU_ISA": onednn, "MKL_ENABLE_INSTRUCTIONS": mkl}
    os.environ.update(limits, UDC_SIMD=simd)
    os.execv(sys.executable, [sys.executable, *sys.argv])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--udc", default="target/release/udc", help="the program to compare with")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--seconds", type=float, default=0.5, help="spent on each operation")
    parser.add_argument("--only", default="", help="operations whose names contain this, and the whole network")
    parser.add_argument("--simd", choices=["avx2", "avx512"], help="the most that both may use")
    arguments = parser.parse_args()
    limit_instructions(arguments.simd)
    torch.set_num_threads(arguments.threads)
    command = [arguments.udc, "--threads", str(arguments.threads), "bench", "--patience", str(arguments.seconds)]
    command += ["--only", arguments.only]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    print(f"{lines[0]}; PyTorch {torch.__version__}")
    print(f"{'':48} {'udc ms':>10} {'PyTorch ms':>11} {'ratio':>7}")
    for line in lines[1:]:
        name, ms = re.match(r"(.*?):?\s+([\d.]+) ms", line).groups()
        gradient = any(word in name for word in ("backward", " to ", "training"))
        with torch.set_grad_enabled(gradient):
            for way, call in in_pytorch(name):
                theirs = best(call, arguments.seconds) * 1e3
                print(f"{name + ' ' + way:48} {float(ms):10.2f} {theirs:11.2f} {theirs / float(ms):6.1f}×", flush=True)


if __name__ == "__main__":
    main()
