"""Solves the problems of `egotac bench physics --solver-peer` with Clarabel; prints forces and times as one JSON line.

Needs clarabel, numpy and scipy. Unknowns are the forces and the residual r = w - sum G_i f_i, an equation. A force is in its cone
if (mu n, t1, t2) is in the second-order cone and n is at most the limit.
"""

import argparse
import json

import clarabel
import numpy
from scipy import sparse


def solve(problem):
    """Returns the force at each point (N, contact frame; None = not solved) and the seconds of the solver."""
    points = problem["points"]
    n = len(points)
    inverse = numpy.linalg.inv(numpy.array(problem["covariance"]))
    precision = numpy.repeat([point["precision"] for point in points], 3)
    expected = numpy.concatenate([point["expected"] for point in points])
    cost = sparse.triu(sparse.block_diag([sparse.diags(precision), inverse]), format="csc")
    linear = numpy.concatenate([-precision * expected, numpy.zeros(6)])
    balance = numpy.hstack([numpy.hstack([numpy.array(point["map"]) for point in points]), numpy.eye(6)])
    cones = numpy.zeros((3 * n, 3 * n + 6))
    limits = numpy.zeros((n, 3 * n + 6))
    for index, point in enumerate(points):
        at = 3 * index
        cones[at, at], cones[at + 1, at + 1], cones[at + 2, at + 2] = -point["friction"], -1.0, -1.0
        limits[index, at] = 1.0
    rows = sparse.csc_matrix(numpy.vstack([balance, cones, limits]))
    bounds = numpy.concatenate([problem["wrench"], numpy.zeros(3 * n), [point["limit"] for point in points]])
    kinds = [clarabel.ZeroConeT(6)] + [clarabel.SecondOrderConeT(3)] * n + [clarabel.NonnegativeConeT(n)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(cost, linear, rows, bounds, kinds, settings).solve()
    solved = str(solution.status) == "Solved"
    forces = numpy.array(solution.x[: 3 * n]).reshape(-1, 3).tolist() if solved else None
    return forces, solution.solve_time


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--input", required=True)
    problems = json.load(open(parser.parse_args().input))
    forces, seconds = zip(*(solve(problem) for problem in problems))
    print(json.dumps({"version": clarabel.__version__, "forces": forces, "seconds": seconds}))


main()
