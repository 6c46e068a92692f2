"""The card of an optimised profile."""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from spoofgym.bench.metrics import bootstrap_mean, resamples
from spoofgym.bench.specs import describe
from spoofgym.bench.suite import spoofer_context, versions
from spoofgym.spoofers import Card
from spoofgym.spoofers.card import fields_of

from .profile_choice import Choice
from .profile_run import ProfileRun

ENV_ID = "spoofgym/TightlyCoupled-v0"


def profile_card(run: ProfileRun, choice: Choice, command: list[str]) -> Card:
    """Card of what a search found.

    Parameters
    ----------
    run : ProfileRun
        The search, at its end.
    choice : Choice
        What was taken from it.
    command : list of str
        Command line that made it.

    Returns
    -------
    Card
        Not written yet.
    """
    suite, fields = run.suite, fields_of(spoofer_context(run.setup))
    designed_on = (
        f"{run.detector.label}, {run.setup.attack.label}, scenario {suite.world.name}, "
        f"receiver tuning {run.setup.receiver.tuning}"
    )
    profile = replace(choice.profile, designed_on=designed_on)
    return Card.model_validate(
        {
            "name": run.out.stem,
            "kind": "profile",
            "env_id": ENV_ID,
            "env_kwargs": _env_kwargs(run),
            "observation": None,
            "action": fields["action"],
            "conditions": fields["conditions"],
            "knowledge": {"run_time": "blind", "design_time": designed_on},
            "training": _training(run, choice, command),
            "versions": {**versions(), "cmaes": version("cmaes")},
            "scores": [_score(run, choice)],
            "rivals": rivals(run, choice),
            "settings": describe(
                {
                    "heading_deg": profile.heading_deg,
                    "rates_mps": profile.rates_mps,
                    "cross_rates_mps": profile.cross_rates_mps,
                    "label": profile.label,
                    "designed_on": profile.designed_on,
                }
            ),
            "file": None,
        }
    )


def _env_kwargs(run: ProfileRun) -> dict[str, Any]:
    """What `gymnasium.make` takes to make the game that the profile was optimised for."""
    return {
        "scenario": describe(run.suite.scenario),
        "detector": run.detector.spec,
        "attack": dict(run.suite.config["attack"]),
        "receiver": describe(dict(run.suite.receiver)),
        "timeline": {k: v for k, v in run.suite.config["timeline"].items() if k != "kind"},
        "knowledge": "blind",
        "target_heading_deg": run.settings.search.heading_deg,
    }


def _training(run: ProfileRun, choice: Choice, command: list[str]) -> dict[str, Any]:
    """How the profile was made."""
    settings = run.settings.search
    each = settings.population * settings.batch * run.setup.steps
    return {
        "algorithm": "CMA-ES",
        "command": command,
        "seed": settings.seed,
        "arguments": asdict(run.settings),
        "generations": len(run.generations),
        "steps": len(run.generations) * each,
        "wall_s": round(run.elapsed_s, 1),
        "choice": asdict(choice.fit),
    }


def _score(run: ProfileRun, choice: Choice) -> dict[str, Any]:
    """What the profile reached on the runs of the choice."""
    runs = run.settings.select_runs
    seeds = np.random.default_rng([run.suite.entropy, runs])
    mean = bootstrap_mean(choice.displacement_m, resamples(runs, seeds))
    return {
        "detector": run.detector.label,
        "split": "training",
        "entropy": run.suite.entropy,
        "runs": runs,
        "undetected_displacement_m": mean.value,
        "low": mean.low,
        "high": mean.high,
        "alarm_rate": choice.fit.alarm_rate,
        "clean_alarm_rate": run.ramps[0].clean_alarm_rate,
        "budget": run.budget,
    }


def rivals(run: ProfileRun, choice: Choice) -> list[dict[str, Any]]:
    """The tuned ramps and the profile on the same runs, with all that was tried.

    Parameters
    ----------
    run : ProfileRun
        The search, at its end.
    choice : Choice
        What was taken from it.

    Returns
    -------
    list of dict
        ``spoofer``, ``alarm_rate``, ``undetected_displacement_m``, ``within_budget`` and tables.
    """
    found = []
    for ramp in run.ramps:
        best = next(t for t in ramp.trials if (t.value, t.runs) == (ramp.value, ramp.runs))
        numbers = {
            "spoofer": f"{ramp.spoofer}: {ramp.setting} = {ramp.value:g}",
            "alarm_rate": best.alarm_rate,
            "undetected_displacement_m": best.undetected_displacement_m,
            "within_budget": ramp.within_budget,
        }
        found.append({**numbers, "tuning": ramp.as_dict()})
    fit = choice.fit
    return [
        *found,
        {
            "spoofer": "profile",
            "alarm_rate": fit.alarm_rate,
            "undetected_displacement_m": fit.undetected_displacement_m,
            "within_budget": fit.within_budget,
            "fits": [asdict(item) for item in choice.fits],
        },
    ]
