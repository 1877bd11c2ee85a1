"""The floating-point ceiling of one core: what it reaches at most, and what a kernel asks of it at every sample."""

from __future__ import annotations

import re
import time
from collections import Counter
from typing import Any

import numpy as np

SAMPLES_A_DAY = 288
CHAINS, ROUNDS, SAMPLES = 12, 16, 200_000
"""Enough chains to hide the latency of a fused product, and few enough to stay in the registers."""
_ARITHMETIC = ("fused", "plain", "divisions", "choices")


def most_gflops(precision: str, repeats: int) -> float:
    """The most that chains of fused products reach, of two operations each, 10^9 a second."""
    from glucoloop.native.targets.llvm.kernel import Kernel, lanes

    width = lanes(precision)
    sizes = {"person": 0, "carry": CHAINS, "own": 0, "shared": 0, "outputs": 0}
    kernel = Kernel(_fused_products(width, precision), precision, sizes, width, room=0)
    dtype, best = np.dtype(precision), np.inf
    nothing, carry = np.zeros((SAMPLES, 0, width), dtype), np.ones((CHAINS, width), dtype)
    for _ in range(repeats):
        start = time.perf_counter()
        kernel.run(carry[:0], carry, nothing, np.zeros((SAMPLES, 0), dtype), nothing)
        best = min(best, time.perf_counter() - start)
    return 2e-9 * CHAINS * ROUNDS * SAMPLES * width / best


def _fused_products(width: int, precision: str) -> str:
    """A kernel that multiplies and adds, and nothing else."""
    scalar, bits = ("double", 64) if precision == "float64" else ("float", 32)
    vector, fma = f"<{width} x {scalar}>", f"@llvm.fma.v{width}f{bits}"
    lines = [
        "define void @kernel(ptr %person, ptr %carry, ptr %own, ptr %shared, ptr %outputs, ptr %room, "
        "i64 %stride, i64 %first, i64 %last, i64 %samples) #0 {",
        "entry:",
    ]
    for i in range(CHAINS):
        lines.append(f"  %at{i} = getelementptr {vector}, ptr %carry, i64 {i}")
        lines.append(f"  %start{i} = load {vector}, ptr %at{i}, align {bits // 8}")
    # made of what is read, so that the compiler does not know them: 1 and 0
    lines += [f"  %factor = fmul {vector} %start0, %start1", f"  %term = fsub {vector} %start2, %start3"]
    lines += ["  br label %sample", "sample:", "  %k = phi i64 [ 0, %entry ], [ %next, %sample ]"]
    lines += [f"  %c{i}r0 = phi {vector} [ %start{i}, %entry ], [ %c{i}r{ROUNDS}, %sample ]" for i in range(CHAINS)]
    for r in range(ROUNDS):
        for i in range(CHAINS):
            arguments = f"{vector} %c{i}r{r}, {vector} %factor, {vector} %term"
            lines.append(f"  %c{i}r{r + 1} = call {vector} {fma}({arguments})")
    lines += ["  %next = add i64 %k, 1", "  %more = icmp slt i64 %next, %samples"]
    lines += ["  br i1 %more, label %sample, label %end", "end:"]
    lines += [f"  store {vector} %c{i}r{ROUNDS}, ptr %at{i}, align {bits // 8}" for i in range(CHAINS)]
    lines += ["  ret void", "}", f"declare {vector} {fma}({vector}, {vector}, {vector})"]
    full = width * bits
    lines.append(f'attributes #0 = {{ nounwind "min-legal-vector-width"="{full}" "prefer-vector-width"="{full}" }}')
    return "\n".join(lines) + "\n"


def request_from(kernel: Any) -> dict[str, Any]:
    """What one sample of one vector of people takes.

    ``operations`` are vector operations on numbers, by kind; a fused product is two of ``flops``, every other one is
    one, and what fetches, stores or changes a sign is none. ``instructions`` are those of the processor, by kind.
    """
    told = Counter(map(_kind, _of_samples(kernel.text)))
    return {
        **{kind: told[kind] for kind in _ARITHMETIC},
        "operations": sum(told[kind] for kind in _ARITHMETIC),
        "flops": sum(told[kind] for kind in _ARITHMETIC) + told["fused"],
        "instructions": _instructions(kernel),
    }


def ceilings(asked: dict[str, Any], gflops: float) -> dict[str, float]:
    """Patient-days a second if all went at the rate of fused products.

    Counted by ``flops``, or by ``operations``: a sum or a comparison alone takes the place of a fused product.
    """
    return {
        "flops": 1e9 * gflops / (asked["flops"] * SAMPLES_A_DAY),
        "operations": 0.5e9 * gflops / (asked["operations"] * SAMPLES_A_DAY),
    }


def _of_samples(text: str) -> list[str]:
    """The lines that are carried out at each sample: those of the chunks."""
    result, inside = [], False
    for line in text.splitlines():
        if line and not line.startswith(" "):
            inside = re.match(r"chunk\d+:", line) is not None
        elif inside:
            result.append(line)
    return result


def _kind(line: str) -> str:
    code = line.partition(" = ")[2]
    if "@llvm.fma." in code:
        return "fused"
    if "@llvm.sqrt." in code or code.startswith("fdiv"):
        return "divisions"
    if code.startswith(("fadd", "fsub", "fmul")) or "@llvm.floor." in code:
        return "plain"
    return "choices" if code.startswith(("fcmp", "select")) else ""


def _instructions(kernel: Any) -> dict[str, int]:
    """Instructions of the x86 processor in the chunks; none are known of another."""
    from llvmlite import binding

    from glucoloop.native.targets.llvm.kernel import _machine

    lines = _machine().emit_assembly(binding.parse_assembly(kernel.text)).splitlines()
    labels, loops = {}, []
    for number, line in enumerate(lines):
        if label := re.match(r"(\.LBB\d+_\d+):", line):
            labels[label[1]] = number
        elif (jump := re.match(r"\tj\w+\t(\.LBB\d+_\d+)", line)) and jump[1] in labels:
            loops.append((labels[jump[1]], number))
    # a chunk is a loop without one inside, and the samples the smallest with chunks inside
    outer = [(a, b) for a, b in loops if any(a < c and d < b for c, d in loops)]
    if not outer:
        return {}
    first, last = max(outer)
    result: Counter[str] = Counter()
    for a, b in loops:
        if first < a and b < last:
            result.update(_sort(line.split()) for line in lines[a + 1 : b + 1] if line.startswith("\t"))
    return dict(result)


def _sort(words: list[str]) -> str:
    name, given = words[0], " ".join(words[1:])
    if name.startswith("vmov"):
        return "moves" if "(" not in given else "stores" if given.endswith(")") else "loads"
    if name.startswith("vbroadcast"):
        return "constants"
    return "vector" if name.startswith(("v", "k")) else "addresses"
