# SPDX-License-Identifier: Apache-2.0
"""Balls on rackets of any laws: ``./run python benchmarks/rackets.py --rackets 10 --rows 540``.

Synthetic: every racket is drawn by its seed (restitution, constant or falling with speed; friction; with and without
tangential restitution and drilling friction), and balls bounce by the closed forms of ``test/shared/ball_impacts.py``,
with the noise that fits to real impacts leave. A diagnosis of one table says which laws act; the model with them
predicts another table of the same racket. Errors are those of tt_rackets: mean length of the error of (v_x, v_z) and
mean error of omega_y, beside those of the true laws.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from impact_rs_analysis.diagnosis.diagnose import diagnose
from impact_rs_analysis.evidence.impact_tables import ImpactTableSource
from impact_rs_sim.model import load_model
from impact_rs_trials.recordings.impact_table import ImpactTable, read_impact_table

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "shared"))

from ball_impacts import Racket, ball_table, bounced  # noqa: E402

NOMINAL = load_model(Path("nominal"))
ALIKE = 0.01  # frictions that differ by less make no difference beyond the noise
X, Z, Y_TURNING = 0, 2, 4  # columns of a twist


def drawn(seed: int, assumed: float) -> tuple[Racket, set[str]]:
    """A racket, and the effects that name its laws beside some ``assumed`` friction and no restitution."""
    rng = np.random.default_rng(seed)
    bounce, fall = rng.uniform(0.4, 0.95), rng.choice([0.0, rng.uniform(0.01, 0.03)])
    gripping = rng.random() < 0.5
    back, back_fall = rng.uniform(0.5, 0.9), rng.uniform(0.0, 0.03)
    friction = rng.uniform(0.5, 0.9) if gripping else rng.uniform(0.1, 0.5)
    drilling, spin = rng.choice([0.0, rng.uniform(0.0005, 0.01)]), rng.uniform(0.0, 0.3)
    racket = Racket(
        lambda speed: max(0.0, bounce - fall * speed),
        friction,
        lambda slip: max(0.0, back - back_fall * slip) if gripping else 0.0,
        drilling,
        spin,
    )
    truth = {"restitution"}
    truth |= {"support_friction"} if abs(friction - assumed) > ALIKE else set()
    truth |= {"restitution_fall"} if fall else set()
    truth |= {"tangential_restitution"} if gripping else set()
    truth |= {"drilling_friction"} if drilling else set()
    return racket, truth


def errors(table: ImpactTable, predicted: np.ndarray) -> tuple[float, float]:
    """Mean length of the error of (v_x, v_z) [m/s], mean error of omega_y [rad/s]."""
    rest = np.array([row.after for row in table.rows]) - predicted
    return float(np.mean(np.hypot(rest[:, X], rest[:, Z]))), float(np.mean(np.abs(rest[:, Y_TURNING])))


def main() -> None:
    """Print one line per racket."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rackets", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="seed of the first racket")
    parser.add_argument("--rows", type=int, default=540)
    parser.add_argument("--friction", type=float, default=0.3, help="assumed [-]")
    parser.add_argument("--restitution", type=float, default=0.0, help="assumed [-]")
    args = parser.parse_args()
    assumed = {"friction": args.friction, "restitution": args.restitution}
    right = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + args.rackets):
            racket, truth = drawn(seed, args.friction)
            paths = [Path(folder) / f"{name}_{seed}.csv" for name in ("train", "test")]
            for number, path in enumerate(paths):
                ball_table(path, racket, args.rows, seed=2 * seed + number, **assumed)
            start = time.perf_counter()
            document = diagnose(ImpactTableSource(read_impact_table(paths[0]), NOMINAL), NOMINAL)
            took = time.perf_counter() - start
            named = set(document.named)
            right += named == truth
            effects = {name: document.effect(name).parameters for name in document.named}
            added = tuple((name, tuple(p.estimate for p in found.values())) for name, found in effects.items())
            unseen = read_impact_table(paths[1])
            source = ImpactTableSource(unseen, NOMINAL)
            # Features are in contact axes; the errors are wanted in x, y, z.
            turned = source.predicted_with(added).reshape(-1, 2, 3)
            predicted = np.einsum("nij,nki->nkj", source._axes, turned).reshape(-1, 6)
            exact = np.array([bounced(row.impact.object.twist, racket) for row in unseen.rows])
            (v, w), (least_v, least_w) = errors(unseen, predicted), errors(unseen, exact)
            missed, false = sorted(truth - named), sorted(named - truth)
            print(
                f"racket {seed}: {v:.3f} m/s / {w:.1f} rad/s, true laws {least_v:.3f} / {least_w:.1f}"
                f" ({100.0 * (v / least_v - 1.0):+.1f} / {100.0 * (w / least_w - 1.0):+.1f} %);"
                f" {len(truth)} laws, missed {missed or 'none'}, false {false or 'none'}; {took:.0f} s",
                flush=True,
            )
    print(f"right: {right} of {args.rackets}")


if __name__ == "__main__":
    main()
