#!/usr/bin/env python3
"""Writes expected.json beside this file: scores by scikit-learn, scipy and numpy of fields that tests/score/metrics.rs
builds by the same integer formulas. Needs numpy, scipy, scikit-learn."""
import json
import pathlib
import warnings

import numpy as np
from scipy import stats
from sklearn import metrics as sk

warnings.filterwarnings("ignore")
T, V, FPS = 64, 1556, 25.0


def mix(x):  # splitmix64
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def bits(x, shift, modulus):
    return ((x >> np.uint64(shift)) % np.uint64(modulus)).astype("f4")


with np.errstate(over="ignore"):
    a = mix(np.arange(T * V, dtype=np.uint64)).reshape(T, V)
    b = mix(a)
t = np.arange(T)[:, None]
touched = (bits(a, 8, 20) < 1 + t % 5) & (t % 7 != 0)  # every seventh frame has no contact
force = np.where(touched, bits(a, 20, 512) / 256, 0).astype("f4")
with np.errstate(over="ignore"):
    factor = (2 + bits(mix(1000 + t.astype(np.uint64)), 3, 16)) / 16  # so that the predicted rhythm differs
pred_force = np.where(bits(b, 3, 8) < 6, force * factor, bits(b, 20, 64) / 256).astype("f4")
contact = force > np.float32(0.05)
score = ((bits(b, 30, 64) + 32 * contact) / 96).astype("f4")  # many ties
mask_force = bits(a, 45, 13) != 0
mask_contact = bits(b, 45, 11) != 0


def contact_scores(y, s):
    hard = s > 0.5
    return dict(precision=sk.precision_score(y, hard, zero_division=0), recall=sk.recall_score(y, hard),
                f1=sk.f1_score(y, hard), iou=sk.jaccard_score(y, hard), auroc=sk.roc_auc_score(y, s))


def spectrum(s):
    return np.abs(np.fft.rfft(np.hanning(len(s)) * (s - s.mean())))


def normalise(s, low, high):
    return np.clip((s - low) / (high - low), 0, 1) if high > low else (s > 0).astype("f8")


def runs_of(known):
    """First and last index of each run of known frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    return list(zip(edges[::2], edges[1::2]))


def weighted(rows):
    """Mean over runs, weighted by frames; NaN without a run."""
    return np.average([v for v, _ in rows], weights=[n for _, n in rows]) if rows else np.nan


def spectral(x, y):
    """DFT Pearson, spectral convergence and dominant frequency error of one run; None where the truth is constant."""
    if len(y) < 3 or np.ptp(y) == 0:
        return None
    freq = np.fft.rfftfreq(len(y), 1 / FPS)
    fy = spectrum(y)
    if np.ptp(x) == 0:
        return 0.0, 1.0, freq[1 + fy[1:].argmax()]
    fx = spectrum(x)
    return (stats.pearsonr(np.log1p(fx), np.log1p(fy))[0], np.linalg.norm(fx - fy) / np.linalg.norm(fy),
            abs(freq[1 + fx[1:].argmax()] - freq[1 + fy[1:].argmax()]))


def events(x, y, sign):
    """F1 of the steps in one direction; None if neither side has one."""
    truth, guess = (np.concatenate([sign * np.diff(s) > 1e-4 for s in side]) for side in (y, x))
    return sk.f1_score(truth, guess) if truth.any() or guess.any() else None


def temporal(runs, normal, spectra):
    """Scores of one episode; each argument: (predicted, true) runs, as read, normalised, and those for spectra."""
    x, y = (np.concatenate([run[k] for run in runs]) if runs else np.zeros(0) for k in (0, 1))
    if len(y) < 2 or np.ptp(y) == 0:
        return {}
    nx, ny = (np.concatenate([run[k] for run in normal]) for k in (0, 1))
    of_runs = [(spectral(*run), len(run[0])) for run in spectra]
    each = [weighted([(v[k], n) for v, n in of_runs if v is not None]) for k in range(3)]
    return dict(
        temporal_pearson=stats.pearsonr(x, y)[0] if np.ptp(x) > 0 else 0.0,
        force_cosine=nx @ ny / (np.linalg.norm(nx) * np.linalg.norm(ny) + 1e-300),
        rise_f1=events([r[0] for r in normal], [r[1] for r in normal], 1),
        fall_f1=events([r[0] for r in normal], [r[1] for r in normal], -1),
        dft_pearson=each[0], spectral_convergence=each[1], dominant_frequency_error_hz=each[2])


TEMPORAL = ["temporal_pearson", "force_cosine", "rise_f1", "fall_f1", "dft_pearson", "spectral_convergence",
            "dominant_frequency_error_hz"]


def evaluate(force, pred_force, mf, mc, ends, calibration):
    contact = force > np.float32(0.05)
    f, p = force.astype("f8"), pred_force.astype("f8")
    error = np.abs(p - f)
    active = mf & contact
    known = mf.any(1)
    with_contact = [i for i in range(T) if mc[i].any()]
    frames = [i for i in with_contact if contact[i][mc[i]].any()]
    quiet = [i for i in with_contact if i not in frames]
    per_frame = [contact_scores(contact[i][mc[i]], score[i][mc[i]]) for i in frames]
    alarms = np.concatenate([score[i][mc[i]] > 0.5 for i in quiet])
    st, sp = (np.array([row[m].sum() for row, m in zip(side, mf)]) for side in (f, p))
    ranges = calibration or [(s[known].min(), s[known].max()) for s in (sp, st)]
    rows = []
    for lo, hi in zip([0] + ends[:-1], ends):
        runs = [(sp[lo + a:lo + b], st[lo + a:lo + b]) for a, b in runs_of(known[lo:hi])]
        normal = [tuple(normalise(s, *r) for s, r in zip(run, ranges)) for run in runs]
        rows.append(temporal(runs, normal, normal if calibration else runs))
    out = dict(mae=error[mf].mean(), active_mae=error[active].mean())
    for k in TEMPORAL:
        values = [row[k] for row in rows if row.get(k) is not None and np.isfinite(row[k])]
        out[k] = float(np.mean(values))
        out.setdefault("episodes_defined", {})[k] = len(values)
    out["frame_mean"] = {k: np.mean([row[k] for row in per_frame]) for k in per_frame[0]}
    out["pooled"] = contact_scores(contact[mc], score[mc])
    out["share_without_positives"] = len(quiet) / len(with_contact)
    out["false_positive_rate"] = alarms.mean()
    out["counts"] = dict(frames=T, episodes=len(ends), frames_without_positives=len(quiet),
                         contact_frames=len(with_contact), trace_frames=int(known.sum()),
                         force_entries=int(mf.sum()), active_entries=int(active.sum()), contact_entries=int(mc.sum()),
                         unknown_predictions=0)
    return out


def egophi(force, pred_force, mf, mc):
    """EgoPHI's protocol as its paper and evaluation script describe it: per hand in each frame in which it touches."""
    contact = force > np.float32(0.05)
    rows = []
    for i in range(T):
        for hand in (slice(0, 778), slice(778, 1556)):
            y, s, m = contact[i, hand], score[i, hand], mc[i, hand]
            if not y[m].any():
                continue
            y_, hard = y[m], s[m] > 0.3
            f, p, k = force[i, hand].astype("f8"), pred_force[i, hand].astype("f8"), mf[i, hand]
            touched = y & k
            rows.append([
                sk.precision_score(y_, hard, zero_division=0), sk.recall_score(y_, hard), sk.f1_score(y_, hard),
                sk.jaccard_score(y_, hard), sk.mean_absolute_error(f[touched], p[touched]),
                np.sqrt(sk.mean_squared_error(f[touched], p[touched])),
                np.minimum(f, p)[k].sum() / np.maximum(f, p)[k].sum()])
    names = ["precision", "recall", "f1", "iou", "masked_mae", "masked_rmse", "volumetric_iou"]
    return dict(zip(names, np.mean(rows, axis=0))) | dict(hands=len(rows))


everywhere = np.ones((T, V), bool)
ranges = [(20, 200), (10, 150)]
# Gaps: frames masked whole, at both ends of episodes and within; contact is masked in other frames than force.
gaps = dict(ends=[23, 50, 60, 64])
gap_force, gap_contact = mask_force.copy(), mask_contact.copy()
gap_force[50:], gap_contact[50:] = True, True
gap_force[[0, 5, 6, 12, 22, 23, 31, 40, 41, 55]] = False
gap_contact[[0, 5, 6, 12, 62]] = False
held, changed = pred_force.copy(), force.copy()
held[50:60] = 0.25  # a constant prediction
changed[60:] = 0  # truth that does not change
cases = {"plain": evaluate(force, pred_force, everywhere, everywhere, [T], None),
         "masked_episodes": evaluate(force, pred_force, mask_force, mask_contact, [23, 50, 64], None),
         "calibrated": evaluate(force, pred_force, everywhere, everywhere, [T], ranges),
         "gaps": evaluate(changed, held, gap_force, gap_contact, gaps["ends"], None),
         "gaps_calibrated": evaluate(changed, held, gap_force, gap_contact, gaps["ends"], ranges),
         "egophi": egophi(changed, held, gap_force | (changed > 0.05), gap_contact)}
with open(pathlib.Path(__file__).parent / "expected.json", "w") as file:
    json.dump(cases, file, indent=1)
    file.write("\n")
