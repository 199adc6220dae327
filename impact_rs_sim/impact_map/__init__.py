# SPDX-License-Identifier: Apache-2.0
"""The impact map: ante-impact state in, post-impact or settled state out.

* :mod:`.problem`: the impact problem, its checks and its result; :mod:`.contacts`: contact points of boxes
* :mod:`.laws`: terms, contact laws and residuals; :mod:`.solve`: Newton's and Poisson's law of restitution;
  :mod:`.settled`: the settled contact; :mod:`.uniqueness`: spread of several solutions of the laws
* :mod:`.measured`: impacts of a table, with the laws of :mod:`.contact_laws`
* :mod:`.derivatives` and :mod:`.uncertainty`: parameters, derivatives and intervals of a prediction
* :mod:`.bullet`: independent check by single steps of a physics engine; no other module depends on it
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

_MAX_WARM = 8  # engines kept for the next problem; a Bullet world is a few MB
_warm: OrderedDict[tuple[int, str], Engine] = OrderedDict()
_lock = threading.Lock()


def engine_name(name: str) -> str:
    """Present name of an engine; ``name`` may come from an older version.

    Raises:
        InputError: There is no such engine.
    """
    engine = FORMER_NAMES.get(name, name)
    if engine not in ENGINES:
        raise InputError(f"no impact-map engine {engine!r}; known engines: {', '.join(ENGINES)}")
    return engine


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
    with _lock:
        # An engine refers to its physics, so no other object can get this id while the entry exists.
        key = (id(problem.physics), engine)
        if key not in _warm:
            check_problem(problem)
            _warm[key] = ENGINES[engine](problem.physics)
        _warm.move_to_end(key)
        while len(_warm) > _MAX_WARM:
            _warm.popitem(last=False)[1].close()
        return _warm[key].solve(problem)


def predict_impact(problem: ImpactProblem, contact: str = "first", engine: str = DEFAULT_ENGINE) -> ImpactResult:
    """The velocities after an impact.

    Args:
        problem: The problem.
        contact: ``first``: just after the first simultaneous impact, :func:`compute_impact_map`; ``settled``: when the
            contact has settled, :func:`~impact_rs_sim.impact_map.settled.settle`.
        engine: Engine for ``first``; ``settled`` has one solver.

    Raises:
        InputError: There is no such contact or engine, or the problem is refused.
        ImpactMapError: The result breaks a law by more than the engine's tolerance.
    """
    if contact not in CONTACTS:
        raise InputError(f"no contact {contact!r}; known: {', '.join(CONTACTS)}")
    engine = engine_name(engine)
    return settle(problem) if contact == "settled" else compute_impact_map(problem, engine)
