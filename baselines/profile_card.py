"""The card of an optimised profile."""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from spoofgym.bench.experiments.identity import versions
from spoofgym.bench.scores.statistics import bootstrap_mean, resamples_of
from spoofgym.bench.search.amplitude import Trial
from spoofgym.core.settings import describe
from spoofgym.envs.spoofer_binding import spoofer_context
from spoofgym.policies.card import DECIDED_ON
from spoofgym.spoofers import Card
from spoofgym.spoofers.card import fields_of

from .profile_choice import Choice, Fit
from .profile_run import ProfileRun

ENV_ID = "spoofgym/TightlyCoupled-v0"


def profile_card(run: ProfileRun, choice: Choice, command: str) -> Card:
    """Card of what a search found."""
    fields = fields_of(spoofer_context(run.setup))
    designed_on = (
        f"{run.detector.label}, {run.setup.attack.label}, scenario {run.setup.name}, "
        f"receiver tuning {run.setup.receiver.tuning}"
    )
    profile = replace(choice.profile, label=run.out.stem, designed_on=designed_on)
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
    suite = run.suite
    return {
        "receiver": {},
        **describe(suite.world.given),
        "detector": run.detector.spec,
        "attack": dict(suite.config["attack"]),
        "action": {"name": "full-command"},  # of any rate that the attack allows
        "timeline": {k: v for k, v in suite.config["timeline"].items() if k != "kind"},
        "knowledge": "blind",
        "target_heading_deg": run.settings.search.heading_deg,
    }


def _training(run: ProfileRun, choice: Choice, command: str) -> dict[str, Any]:
    """How the profile was made."""
    settings = run.settings.search
    each = settings.population * settings.batch * run.setup.steps
    return {
        "algorithm": "CMA-ES",
        "command": command,
        "seed": settings.seed,
        "arguments": asdict(run.settings),
        DECIDED_ON: [[run.suite.entropy, "training"]],
        "aimed_alarm_rate": run.aim,
        "generations": len(run.generations),
        "steps": len(run.generations) * each,
        "wall_s": round(run.elapsed_s, 1),
        "choice": asdict(choice.fit),
    }


def _score(run: ProfileRun, choice: Choice) -> dict[str, Any]:
    """What the profile reached on the runs of the choice."""
    runs = run.settings.select_runs
    mean = bootstrap_mean(choice.displacement_m, resamples_of(np.arange(choice.fit.counted)))
    return {
        "detector": run.detector.label,
        "split": "training",
        "entropy": run.suite.entropy,
        "runs": runs,
        "counted": choice.fit.counted,
        "undetected_displacement_m": mean.value,
        "low": mean.low,
        "high": mean.high,
        "alarm_rate": choice.fit.alarm_rate,
        "clean_alarm_rate": run.ramps[0].clean_alarm_rate,
        "budget": run.budget,
    }


def rivals(run: ProfileRun, choice: Choice) -> list[dict[str, Any]]:
    """The tuned ramps and the profile on the same runs, with all that was tried. Returns
    ``spoofer``, ``alarm_rate``, ``alarm_limit``, ``stealthy_displacement_m``, ``within_budget`` and
    tables."""
    found: list[dict[str, Any]] = []
    for ramp in run.ramps:
        name = f"{ramp.spoofer}: {ramp.setting} = {ramp.value:g}"
        found.append({"spoofer": name, **_numbers(ramp.chosen), "tuning": ramp.as_dict()})
    fits = [asdict(fit) for fit in choice.fits]
    return [*found, {"spoofer": "profile", **_numbers(choice.fit), "fits": fits}]


def _numbers(tried: Trial | Fit) -> dict[str, Any]:
    """What a spoofer did on the runs of the choice."""
    return {
        "alarm_rate": tried.alarm_rate,
        "alarm_limit": tried.alarm_limit,
        "stealthy_displacement_m": tried.stealthy_displacement_m,
        "within_budget": tried.within_budget,
    }
