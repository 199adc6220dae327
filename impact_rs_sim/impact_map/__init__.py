# SPDX-License-Identifier: Apache-2.0
"""The impact map: ante-impact state in, post-impact or settled state out.

* :mod:`.problem`: the impact problem, its checks and its result; :mod:`.contacts`: contact points of boxes
* :mod:`.laws`: terms, contact laws and residuals; :mod:`.solve`: Newton's and Poisson's law of restitution;
  :mod:`.settled`: the contact that lasts; :mod:`.uniqueness`: spread where the laws have several solutions
* :mod:`.measured`: impacts of a table, with the laws of :mod:`.contact_laws`
* :mod:`.derivatives` and :mod:`.uncertainty`: parameters, derivatives and intervals of a prediction
* :mod:`.bullet`: the independent check, from single steps of a physics engine; nothing else builds on it
"""

from __future__ import annotations

import threading
from collections import OrderedDict

from impact_rs_sim.errors import InputError
from impact_rs_sim.impact_map.bullet import BulletEngine
from impact_rs_sim.impact_map.problem import (
    ContactImpulse,
    ImpactMapError,
    ImpactProblem,
    ImpactResult,
    Residual,
    check_problem,
    kinetic_energy,
)
from impact_rs_sim.impact_map.settled import settle
from impact_rs_sim.impact_map.solve import Engine, ExactEngine

__all__ = [
    "CONTACTS",
    "DEFAULT_ENGINE",
    "ENGINES",
    "BulletEngine",
    "ContactImpulse",
    "Engine",
    "ExactEngine",
    "ImpactMapError",
    "ImpactProblem",
    "ImpactResult",
    "PinocchioEngine",
    "Residual",
    "check_problem",
    "compute_impact_map",
    "engine_name",
    "kinetic_energy",
    "predict_impact",
    "settle",
]

ENGINES: dict[str, type[Engine]] = {engine.name: engine for engine in (ExactEngine, BulletEngine)}
DEFAULT_ENGINE = ExactEngine.name
FORMER_NAMES = {"pinocchio": ExactEngine.name}
PinocchioEngine = ExactEngine  # its name up to version 0.1.0

CONTACTS = ("first", "settled")  # just after the first impact, or when the contact has settled

_KEPT = 8  # engines kept warm; a Bullet world is a few MB
_warm: OrderedDict[tuple[int, str], Engine] = OrderedDict()
_lock = threading.Lock()


def engine_name(name: str) -> str:
    """The present name of an engine that may have been named by an older version."""
    return FORMER_NAMES.get(name, name)


def compute_impact_map(problem: ImpactProblem, engine: str = DEFAULT_ENGINE) -> ImpactResult:
    """Solve ``problem``.

    The engine stays warm for the next problem with the same :class:`~impact_rs_sim.physics.Physics` object.

    Args:
        problem: The problem.
        engine: ``exact``, or ``bullet``, the independent check; ``pinocchio`` is the former name of ``exact``.

    Raises:
        InputError: There is no such engine, or the problem is refused.
        ImpactMapError: The result breaks a law by more than the engine's tolerance.
    """
    engine = engine_name(engine)
    if engine not in ENGINES:
        raise InputError(f"no impact-map engine {engine!r}; known engines: {', '.join(ENGINES)}")
    with _lock:
        # An entry holds its physics, so an id cannot come to mean another object while it is in the table.
        key = (id(problem.physics), engine)
        if key not in _warm:
            check_problem(problem)
            _warm[key] = ENGINES[engine](problem.physics)
        _warm.move_to_end(key)
        while len(_warm) > _KEPT:
            _warm.popitem(last=False)[1].close()
        return _warm[key].solve(problem)


def predict_impact(problem: ImpactProblem, contact: str = "first", engine: str = DEFAULT_ENGINE) -> ImpactResult:
    """The velocities after an impact.

    Args:
        problem: The problem.
        contact: ``first``: just after the first simultaneous impact, :func:`compute_impact_map`; ``settled``: when the
            contact that lasts is closed, :func:`~impact_rs_sim.impact_map.settled.settle`.
        engine: Engine of the first; the second has one solver.

    Raises:
        InputError: There is no such contact or engine, or the problem is refused.
        ImpactMapError: The result breaks a law by more than the engine's tolerance.
    """
    if contact not in CONTACTS:
        raise InputError(f"no contact {contact!r}; known: {', '.join(CONTACTS)}")
    return settle(problem) if contact == "settled" else compute_impact_map(problem, engine)
