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


def safe(x):
    return None if not np.isfinite(x) else float(x)


def contact_scores(y, s):
    hard = s > 0.5
    return dict(precision=sk.precision_score(y, hard, zero_division=0), recall=sk.recall_score(y, hard),
                f1=sk.f1_score(y, hard), iou=sk.jaccard_score(y, hard), auroc=sk.roc_auc_score(y, s))


def spectrum(s):
    return np.abs(np.fft.rfft(np.hanning(len(s)) * (s - s.mean())))


def evaluate(mf, mc, ends, calibration):
    f, p = force.astype("f8"), pred_force.astype("f8")
    error = np.abs(p - f)
    active = mf & (force > np.float32(0.05))
    frames = [i for i in range(T) if contact[i][mc[i]].any()]
    per_frame = [contact_scores(contact[i][mc[i]], score[i][mc[i]]) for i in frames]
    st, sp = (f * mf).sum(1), (p * mf).sum(1)
    norm = [np.clip((s - lo) / (hi - lo), 0, 1)
            for s, (lo, hi) in zip((sp, st), calibration or [(s.min(), s.max()) for s in (sp, st)])]
    episodes = list(zip([0] + ends[:-1], ends))
    rows = []
    for lo, hi in episodes:
        x, y, nx, ny = sp[lo:hi], st[lo:hi], norm[0][lo:hi], norm[1][lo:hi]
        fx, fy = spectrum(x), spectrum(y)
        freq = np.fft.rfftfreq(hi - lo, 1 / FPS)
        rows.append(dict(
            temporal_pearson=stats.pearsonr(x, y)[0],
            force_cosine=nx @ ny / np.linalg.norm(nx) / np.linalg.norm(ny),
            rise_f1=sk.f1_score(np.diff(ny) > 1e-4, np.diff(nx) > 1e-4),
            fall_f1=sk.f1_score(np.diff(ny) < -1e-4, np.diff(nx) < -1e-4),
            dft_pearson=stats.pearsonr(np.log1p(fx), np.log1p(fy))[0],
            spectral_convergence=np.linalg.norm(fx - fy) / np.linalg.norm(fy),
            dominant_frequency_error_hz=abs(freq[1 + fx[1:].argmax()] - freq[1 + fy[1:].argmax()])))
    out = dict(mae=error[mf].mean(), active_mae=error[active].mean())
    out |= {k: safe(np.mean([row[k] for row in rows])) for k in rows[0]}
    out["frame_mean"] = {k: np.mean([row[k] for row in per_frame]) for k in per_frame[0]}
    out["pooled"] = contact_scores(contact[mc], score[mc])
    out["counts"] = dict(frames=T, episodes=len(ends), frames_without_positives=T - len(frames),
                         force_entries=int(mf.sum()), active_entries=int(active.sum()), contact_entries=int(mc.sum()),
                         unknown_predictions=0)
    return out


everywhere = np.ones((T, V), bool)
cases = {"plain": evaluate(everywhere, everywhere, [T], None),
         "masked_episodes": evaluate(mask_force, mask_contact, [23, 50, 64], None),
         "calibrated": evaluate(everywhere, everywhere, [T], [(20, 200), (10, 150)])}
with open(pathlib.Path(__file__).parent / "expected.json", "w") as file:
    json.dump(cases, file, indent=1)
