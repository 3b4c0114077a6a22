#!/usr/bin/env python3
"""Derives the polynomials of crates/kernels/src/simd.rs (needs numpy and scipy; prints Rust arrays).

Lawson's iteration: weighted least squares whose weights grow where the relative error is largest, until it is level.
"""
import numpy as np
from scipy.special import erfc, erfcx


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


def level_product(f, high, degree, nodes=4000, rounds=150):
    """f(a) by a polynomial in 2 a / high - 1 for a in 0 to high; the error times a / max(a, 1) + 0.02 is level."""
    s = -np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes)
    a = high / 2 * (1 + s)
    y, scale = f(a), a / np.maximum(a, 1) + 0.02
    chebyshev = np.polynomial.chebyshev.chebvander(s, degree)
    weights, best = np.ones(nodes), (np.inf, None)
    for _ in range(rounds):
        root = np.sqrt(weights) * scale
        c = np.linalg.lstsq(chebyshev * root[:, None], y * root, rcond=None)[0]
        error = np.abs(chebyshev @ c - y) * scale
        best = min(best, (error.max(), tuple(np.polynomial.chebyshev.cheb2poly(c))))
        weights = weights * (error / error.mean() + 1e-3)
        weights /= weights.mean()
    return best


def show(name, result, kind="relative"):
    print(f"// largest {kind} error {result[0]:.1e}\nconst {name}: [f32; {len(result[1])}] = [")
    for c in result[1]:
        print(f"    {np.float32(c)!s},")
    print("];")


C = 0.3  # of t = 1 / (1 + C a)
TAIL = level(lambda t: 0.5 * erfcx((1 / t - 1) / C / np.sqrt(2)), 1 / (1 + C * 14), 1.0, 8)
SATURATION = 5.3
UPPER = level_product(lambda a: 0.5 * erfc(a / np.sqrt(2)), SATURATION, 15)
EXP = level(np.exp, -np.log(2) / 2, np.log(2) / 2, 6)

if __name__ == "__main__":
    show("TAIL", TAIL)
    show("EXP", EXP)
    show("UPPER", UPPER, "weighted")
