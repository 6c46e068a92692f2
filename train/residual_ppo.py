"""Plain PPO that corrects the best attacks without learning, beside them.

    python -m train.residual_ppo --list                 # what it trains, and its CPU minutes
    python -m train.residual_ppo --out runs/residual
    python -m train.residual_ppo --base feedback        # of the scripted feedback alone

The bases: the open-loop attack that a search finds against the detector, and `feedback-profile`
along the same curve, whose `full_ratio` is the best of `FULL_RATIOS`, both at exactly the alarm
budget.  PPO with the arguments of `PLAIN` begins with corrections of 0 and small noise.  Prices of
an alarm are tried with the first seed, and checkpoints, the base among them, with each; the best
are kept.  All that is chosen is chosen on runs of their own; then what is kept, its base and the
scripts are scored on others, and ratios are paired.  The papers' world; after a kill the same
command goes on with the seed that was learning.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import Part, Records, error_lines, learning_versions
from agents.learning import learn, run_training, set_price
from agents.seeds import format_range
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT, TuningResult
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers.learned import ModelPolicy, describe_env, get_normalization, make_function
from spoofgym.spoofers.residual import SHARE

from .offsets_ppo import NUM_ENVS, PACE, PLAIN, WORLD

KNOWLEDGE = {"blind": "blind", "statistics": "oracle"}
"""What the correction is of, by the words of the table."""
OPEN_LOOP, FEEDBACK = "open-loop", "feedback"
FASTER = {OPEN_LOOP: 1, FEEDBACK: 5}
"""Bases, and their decisions in the time of one of `PACE`: feedback has to answer sooner."""
SCRIPT = "feedback-profile"
FULL_RATIOS = (0.4, 0.5, 0.6, 0.7, 0.8)
LEAST_SCALE_MPS, ROOM = 2.0, 1.5
"""Least rate that an action of 1 requests, and how many times the base's largest it is."""
LOG_STD, CHECKPOINTS = -2.0, 4
CHOICE, FINAL = 1, 2
"""Entropy of the runs on which all is chosen, and of those that are scored."""
SEARCH_MINUTES, MINUTES = 6.0, 3.0
"""Of a core, roughly: a search with the scripts' scores, and a training of 200,000 decisions."""
HEAD = (
    *("detector", "attack", "sees", "price of an alarm [m]"),
    *("score [m], of several seeds median and range",),
    *("over its base, each seed (a script: over the open-loop attack)",),
    *("over scripted feedback, each seed", "last policy over its base", "alarms as trained [%]"),
)


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/residual")  # Folder of the results.
    detectors: tuple[str, ...] = ("ewma", "joint-chart")  # At 0.2 false alarms an hour.
    base: tuple[str, ...] = tuple(FASTER)  # What is corrected.
    knowledge: tuple[str, ...] = tuple(KNOWLEDGE)  # What corrections are of.
    seeds: tuple[int, ...] = (0, 1, 2)  # One training each, of the first for every price.
    steps: int = 200_000  # Decisions of 10 s, or their time, of all receivers together.
    prices_m: tuple[float, ...] = (60.0, 300.0)  # Prices of an alarm that are tried [m].
    runs: int = 1024  # Runs of the last scores; half as many for the choice.
    list: bool = False  # Only say what is trained, and how long it takes.

    def __post_init__(self) -> None:
        for word, given, valid in (
            ("base", self.base, FASTER),
            ("knowledge", self.knowledge, KNOWLEDGE),
        ):
            for each in given:
                check_choice(word, each, valid)

    def cases(self) -> Iterator[Case]:
        """Rows of trainings; feedback sees statistics, and is corrected with them alone."""
        for detector in self.detectors:
            for base in self.base:
                for knowledge in self.knowledge if base == OPEN_LOOP else (*KNOWLEDGE,)[1:]:
                    yield Case(detector, base, knowledge)


class Case(NamedTuple):
    """A row of trainings."""

    detector: str
    base: str
    knowledge: str

    def name_trial(self, price_m: float) -> str:
        return f"{' '.join(self)} {price_m:g} m"

    def name_seed(self, seed: int) -> str:
        return f"{' '.join(self)} {seed}"


@cache
def make_judge(settings: Settings, detector: str, entropy: int) -> Evaluator:
    runs = settings.runs // 2 if entropy == CHOICE else settings.runs
    sizes: dict[str, Any] = {"runs": runs, "fit_runs": runs, "rule": EXACT}
    return Evaluator(detector=detector, entropy=entropy, **WORLD, **sizes)


def make_env(base: str, spec: dict[str, Any], knowledge: str) -> dict[str, Any]:
    """Settings of an environment whose actions correct a base."""
    largest = max(spec["rates_mps"])
    full_scale_mps = max(LEAST_SCALE_MPS, ROOM * largest)
    action: dict[str, Any] = {"name": "residual", "spoofer": spec}
    action |= {"scale": SHARE * largest / full_scale_mps}
    action |= {"action": [{"name": "rate-setpoint", "full_scale_mps": full_scale_mps}]}
    pace = {**PACE, "decision_interval_s": PACE["decision_interval_s"] / FASTER[base]}
    return {"knowledge": KNOWLEDGE[knowledge], "action": action, **pace}


def correct_nothing(base: str, spec: dict[str, Any]) -> ModelPolicy:
    """The base at the pace of its corrections."""
    knowledge = "statistics" if base == FEEDBACK else "blind"
    return play_base(base, make_env(base, spec, knowledge))


def play_base(label: str, env: dict[str, Any]) -> ModelPolicy:
    """A policy of an environment with a base, which corrects nothing."""
    return ModelPolicy(lambda seen: np.zeros((len(seen), 1)), label=label, **env)


@cache
def fit_base(settings: Settings, detector: str, base: str, text: str, entropy: int) -> TuningResult:
    """Fit a base, by its spec as JSON, once in a process."""
    policy = correct_nothing(base, json.loads(text))
    return make_judge(settings, detector, entropy).fit(policy)


def scale_rates(spec: dict[str, Any], factor: float) -> dict[str, Any]:
    return {**spec, "rates_mps": np.round(factor * np.asarray(spec["rates_mps"]), 6).tolist()}


def find_open_loop(settings: Settings, detector: str) -> dict[str, Any]:
    """The optimized open-loop attack at the amplitude that keeps the budget."""
    found = make_judge(settings, detector, CHOICE).fit(OPEN_LOOP)
    assert found.found is not None  # as of every search
    spec = {"name": OPEN_LOOP, "rates_mps": found.found["played"]["rates_mps"]}
    return {"spec": scale_rates(spec, found.value), "script": {"name": OPEN_LOOP}}


def find_feedback(settings: Settings, detector: str, curve: dict[str, Any]) -> dict[str, Any]:
    """The best `full_ratio` of feedback along a curve, as a base and as the script itself."""
    judge = make_judge(settings, detector, CHOICE)
    found: dict[str, Any] = {}
    tried = [{**curve, "name": SCRIPT, "full_ratio": each} for each in FULL_RATIOS]
    for name, make in (("spec", lambda x: correct_nothing(FEEDBACK, x)), ("script", lambda x: x)):
        fits = [judge.fit(make(each)) for each in tried]
        reached = [get_metres(fit.at_budget) for fit in fits]
        best = int(np.argmax(reached))
        found |= {name: tried[best], f"{name}_choice_m": reached}
        if name == "spec":
            found[name] = scale_rates(tried[best], fits[best].value)
    return found


def get_metres(score: dict[str, Any] | None) -> float:
    return float(score[MEASURES[0]]["value"]) if score else 0.0


def score_scripts(settings: Settings, detector: str, bases: dict[str, Any]) -> dict[str, Any]:
    """Scores of the bases, as they are corrected and as scripts of every epoch."""
    judge, found = make_judge(settings, detector, FINAL), {}
    rates = bases[OPEN_LOOP]["spec"]["rates_mps"]
    fits = {
        f"{base}{word}": fit
        for base, each in bases.items()
        for word, fit in (
            (", base", fit_base(settings, detector, base, json.dumps(each["spec"]), FINAL)),
            ("", judge.fit({"rates_mps": rates, **each["script"]})),
        )
    }
    first = fits[f"{OPEN_LOOP}, base"].trace
    for name, fit in fits.items():
        ratio = ratio_at_budget(fit.trace, first, BUDGET).as_json()
        found[name] = {"score": fit.at_budget, "amplitude": fit.value, "ratio": ratio}
    return found


def make_model(
    own: dict[str, Any],
    price_m: float,
    seed: int,
    num_envs: int = NUM_ENVS,
    faster: int = 1,
    log_std: float = LOG_STD,
    **further: Any,
) -> PPO:
    """PPO whose first corrections are 0 but for exploration; `own`: settings of the environment."""
    vector = SpoofVecEnv(num_envs, seed=1000 * seed, warm_pool=num_envs, **own)
    set_price(vector, price_m / vector.core.length_m)
    plain = {x: faster * PLAIN[x] for x in ("n_steps", "batch_size")}
    plain["batch_size"] = plain["batch_size"] * num_envs // NUM_ENVS
    how: dict[str, Any] = {**PLAIN, **plain, "policy_kwargs": {"log_std_init": log_std}, **further}
    envs = VecNormalize(vector, gamma=1.0)
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **how)
    with torch.no_grad():
        for each in model.policy.action_net.parameters():
            each.zero_()
    return model


def freeze(model: PPO) -> ModelPolicy:
    """The policy as it is now, apart from the one that goes on learning."""
    spaces, normalize = (model.observation_space, model.action_space), get_normalization(model)
    assert normalize is not None  # as of `make_model`
    kwargs = {"use_sde": model.use_sde, **model.policy_kwargs}
    policy = model.policy_class(*spaces, lambda _: 0.0, **kwargs)
    policy.load_state_dict(model.policy.state_dict())
    play_policy = make_function(policy)
    act = lambda seen: play_policy(normalize(seen))  # noqa: E731
    return ModelPolicy(act, label="residual", **describe_env(model.get_env()))


def train(
    settings: Settings, case: Case, bases: dict[str, Any], price_m: float, seed: int
) -> dict[str, Any]:
    """One training, the choice of a checkpoint, and scores on other runs."""
    texts = {name: json.dumps(each["spec"]) for name, each in bases.items()}
    env = make_env(case.base, bases[case.base]["spec"], case.knowledge)
    own = {**WORLD, "detector": case.detector, **env}
    model = make_model(own, price_m, seed, NUM_ENVS, FASTER[case.base])
    policies, why, began = [], None, time.perf_counter()
    for _ in range(CHECKPOINTS):
        steps = FASTER[case.base] * settings.steps // CHECKPOINTS
        why = why or learn(model, steps, reset_num_timesteps=False)
        if why is None:
            policies.append(freeze(model))
    row: dict[str, Any] = {"seed": seed, "price_m": price_m, "diverged": why}
    row |= {"wall_s": round(time.perf_counter() - began, 1)}
    model.get_env().close()
    fit_rival = lambda name, entropy: fit_base(  # noqa: E731
        settings, case.detector, name, texts[name], entropy
    )
    choice = make_judge(settings, case.detector, CHOICE)
    fits = [fit_rival(case.base, CHOICE), *map(choice.fit, policies)]
    row["choice_m"] = [get_metres(each.at_budget) for each in fits]
    best, final = int(np.argmax(row["choice_m"])), make_judge(settings, case.detector, FINAL)
    row["checkpoint"] = best
    rivals = {name: fit_rival(name, FINAL) for name in texts}
    known = {0: rivals[case.base]}
    for name, number in (("kept", best), ("last", len(policies))):
        if number not in known:
            known[number] = final.fit(policies[number - 1])
        fit = known[number]
        row[name] = {"score": fit.at_budget, "amplitude": fit.value}
        for rival, other in rivals.items():
            row[name][rival] = ratio_at_budget(fit.trace, other.trace, BUDGET).as_json()
    if policies:
        row["as_trained"] = final.score(policies[-1], amplitude=None).as_dict()
    return row


def list_parts(settings: Settings) -> dict[str, Part]:
    """What is searched, scored and trained, in its order."""
    parts: dict[str, Part] = {}
    for detector in settings.detectors:
        names = {base: f"{detector} {base}" for base in FASTER}
        curve, rule = names.values()
        take = lambda done, x=names: {base: done[name] for base, name in x.items()}  # noqa: E731
        parts[curve] = Part(
            {"detector": detector}, lambda *_, x=detector: find_open_loop(settings, x), work=3.0
        )
        parts[rule] = Part(
            {"detector": detector, "full_ratios": FULL_RATIOS},
            lambda done, _, x=detector, c=curve: find_feedback(settings, x, done[c]["spec"]),
            after=(curve,),
        )
        parts[f"{detector} scripts"] = Part(
            {"detector": detector, "full_ratios": FULL_RATIOS},
            lambda done, _, x=detector, take=take: score_scripts(settings, x, take(done)),
            after=(curve, rule),
        )
        for case in settings.cases():
            if case.detector == detector:
                parts |= list_trainings(settings, case, (curve, rule), take)
    return parts


def list_trainings(
    settings: Settings, case: Case, after: tuple[str, ...], take: Callable[..., Any]
) -> dict[str, Part]:
    """The first seed at every price, and the others at the better one."""
    own = {**case._asdict(), "plain": PLAIN, "full_ratios": FULL_RATIOS}
    first, *others = settings.seeds

    def make_part(seed: int, fixed_m: float | None, before: Iterable[str], **told: Any) -> Part:
        def make(done: dict[str, Any], _: Any) -> dict[str, Any]:
            price = fixed_m or choose_trial(settings, case, done)["price_m"]
            return train(settings, case, take(done), price, seed)

        return Part({**own, **told, "seed": seed}, make, after=(*after, *before))

    prices_m = settings.prices_m
    trials = {case.name_trial(x): make_part(first, x, (), price_m=x) for x in prices_m}
    chosen = {"prices_m": prices_m, "first": first}
    more = {case.name_seed(x): make_part(x, None, trials, **chosen) for x in others}
    return trials | more


def choose_trial(settings: Settings, case: Case, cells: dict[str, Any]) -> dict[str, Any]:
    """The first seed at the price with which it got farthest on the choice runs."""
    trials = [cells[case.name_trial(price_m)] for price_m in settings.prices_m]
    return max(trials, key=lambda row: max(row["choice_m"]))


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    sizes = {name: getattr(settings, name) for name in ("steps", "runs")}
    config = {**sizes, "versions": learning_versions()}
    found = Records("residual-ppo", config, list_parts(settings)).play(settings.out, progress)
    kept: dict[str, Any] = {**sizes, "world": WORLD, "full_ratios": FULL_RATIOS, "detectors": {}}
    for detector in settings.detectors:
        kept["detectors"][detector] = {
            "bases": {base: found[f"{detector} {base}"] for base in FASTER},
            "scripts": found[f"{detector} scripts"],
            "rows": {},
        }
    for case in settings.cases():
        trial = choose_trial(settings, case, found)
        rows = [trial, *(found[case.name_seed(seed)] for seed in settings.seeds[1:])]
        trials = [found[case.name_trial(price_m)] for price_m in settings.prices_m]
        told = {"trials": trials, "seeds": rows, "price_m": trial["price_m"]}
        kept["detectors"][case.detector]["rows"][f"{case.base} {case.knowledge}"] = told
    return kept


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each script, and for each base and knowledge of its corrections."""
    lines = []
    for detector, found in results["detectors"].items():
        for name, each in found["scripts"].items():
            ratio, score = interval(each["ratio"], 2), interval(each["score"][MEASURES[0]])
            base, _, corrected = name.partition(", ")
            sees = "statistic" if base == FEEDBACK else "nothing"
            word = f"{base}, {'as it is corrected' if corrected else 'every epoch'}"
            lines.append((f"`{detector}`", word, sees, "-", score, ratio, "-", "-", "-"))
        for name, row in found["rows"].items():
            base, knowledge = name.split()
            scores = [each["kept"]["score"] for each in row["seeds"]]
            several = format_range([get_metres(each) for each in scores])
            reached = several if scores[1:] else interval(scores[0][MEASURES[0]])
            over = {
                (word, rival): "; ".join(interval(each[word][rival], 2) for each in row["seeds"])
                for word in ("kept", "last")
                for rival in FASTER
            }
            alarms = [
                f"{100.0 * each['as_trained']['alarm_rate']['value']:.1f}" for each in row["seeds"]
            ]
            lines.append((
                *(f"`{detector}`", f"PPO on {base}", knowledge, f"{row['price_m']:g}"),
                *(reached, over["kept", base], over["kept", FEEDBACK]),
                *(over["last", base], ", ".join(alarms)),
            ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


def list_plan(settings: Settings) -> Iterator[str]:
    """What is trained, and its CPU minutes."""
    for detector in settings.detectors:
        yield f"{detector}, bases and scripts: about {SEARCH_MINUTES:.0f} CPU minutes"
    for case in settings.cases():
        count = len(settings.prices_m) + len(settings.seeds) - 1
        minutes = MINUTES * settings.steps / 200_000
        yield f"{', '.join(case)}: {count} trainings, about {minutes:.1f} CPU minutes each"


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table, list_plan)


if __name__ == "__main__":
    main()
