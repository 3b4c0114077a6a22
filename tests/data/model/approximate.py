#!/usr/bin/env python3
"""Derives the polynomials of src/model/ops/simd.rs (needs numpy and scipy; prints Rust arrays).

Lawson's iteration: weighted least squares whose weights grow where the relative error is largest, until it is level.
"""
import numpy as np
from scipy.special import erf, erfcx


def level(f, low, high, degree, nodes=4000, rounds=200):
    x = (low + high) / 2 + (high - low) / 2 * np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    y = f(x)
    powers = np.vander(x, degree + 1, increasing=True)
    weights, best = np.ones(nodes), (np.inf, None)
    for _ in range(rounds):
        s = np.sqrt(weights) / np.abs(y)
        c = np.linalg.lstsq(powers * s[:, None], y * s, rcond=None)[0]
        error = np.abs((powers @ c) / y - 1)
        best = min(best, (error.max(), tuple(c)))
        weights = weights * (error / error.mean() + 1e-3)
        weights /= weights.mean()
    return best


def level_ratio(f, high, above, below, nodes=4000, rounds=60):
    """f(x) = x P(x^2) / Q(x^2) for x in 0 to high, the absolute error level; Q begins with 1."""
    x = high / 2 * (1 - np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes))
    s, y = (x / high) ** 2, f(x)
    weights, best = np.ones(nodes), (np.inf, None, None)
    for _ in range(rounds):
        terms = np.hstack([x[:, None] * np.vander(s, above + 1, increasing=True), -y[:, None] * np.vander(s, below + 1, increasing=True)[:, 1:]])
        c = np.linalg.lstsq(terms * weights[:, None], y * weights, rcond=None)[0]
        p, q = c[: above + 1], np.append(1, c[above + 1 :])
        divisor = np.polyval(q[::-1], s)
        error = np.abs(x * np.polyval(p[::-1], s) / divisor - y)
        best = min(best, (error.max(), tuple(p / high ** (2 * np.arange(above + 1))), tuple(q / high ** (2 * np.arange(below + 1)))))
        weights = (1 + 8 * error / error.max()) / np.abs(divisor)
    return best


def show(name, result, kind="relative"):
    print(f"// largest {kind} error {result[0]:.1e}\nconst {name}: [f32; {len(result[1])}] = [")
    for c in result[1]:
        print(f"    {np.float32(c)!s},")
    print("];")


C = 0.3  # of t = 1 / (1 + C a)
TAIL = level(lambda t: 0.5 * erfcx((1 / t - 1) / C / np.sqrt(2)), 1 / (1 + C * 14), 1.0, 8)
FLANK = 5.3
CENTRE = level_ratio(lambda x: 0.5 * erf(x / np.sqrt(2)), FLANK, 5, 5)
EXP = level(np.exp, -np.log(2) / 2, np.log(2) / 2, 6)

if __name__ == "__main__":
    show("TAIL", TAIL)
    show("EXP", EXP)
    show("ABOVE", CENTRE[:2], "absolute")
    show("BELOW", CENTRE[::2], "absolute")
