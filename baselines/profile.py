"""Optimised open-loop profiles: ``python -m baselines.profile --detector ewma --out ewma.json``.

A blind spoofer that plans one curve of the rate for all runs.  A learned blind policy that does not
reach it has not learned anything.

1. A curve is looked for by CMA-ES under the alarm budget (`spoofgym.bench.search.open_loop`).
2. Its amplitude is fitted on training runs, like those of plain curves and of both ramps.
3. The best of them is written as a card, with its score on evaluation runs, which decide nothing.

What is finished stays in the folder ``NAME.search`` beside the card until that is written; after a
kill the same command goes on from there.
"""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from agents.folder import Part, Records, Ticks, describe_identity
from agents.seeds import on_card
from spoofgym import __version__
from spoofgym.bench.experiments import Context, Store
from spoofgym.bench.experiments.calibration import calibrate_players
from spoofgym.bench.experiments.evaluate import RUNS, Evaluator
from spoofgym.bench.experiments.identity import code_identity
from spoofgym.bench.report.campaign import ALARMS
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.world import PLAIN_ID, World
from spoofgym.bench.search.amplitude import TuningResult, search_work
from spoofgym.bench.search.open_loop import SPLIT, OpenLoopSearch
from spoofgym.cli import clear_errors
from spoofgym.cli.app import print_json, progress
from spoofgym.cli.options import list_passed_options
from spoofgym.core.registry import parse_spec, refuse_overrides
from spoofgym.core.settings import describe
from spoofgym.envs.context import spoofer_context
from spoofgym.limits.linear import get_rate_limits
from spoofgym.policies import SpooferCard
from spoofgym.policies.card import DECIDED_ON, NAME, describe_context
from spoofgym.simulation import Timeline
from spoofgym.tasks import get_task

RIVALS = Table(
    (
        "spoofer",
        lambda row: row["spoofer"] + ("" if row["within_budget"] else " (beyond the budget)"),
    ),
    *ALARMS,
    ("stealthy displacement [m]", "stealthy_displacement_m", "{:.2f}".format),
)
app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
SEARCHED = "open-loop"
FITTED = {"ramp": "rate_mps", "accelerating-ramp": "acceleration_mps2", SEARCHED: "amplitude"}
"""Spoofers, and the setting of each that is fitted."""
HIDDEN_OPTIONS = {"threads", "resume", "as_json"}
"""Options that change nothing in the card."""
DECIDED = {"detector", "scenario", "attack", "warmup_s", "live_s", "attack_s", "time_to_alert_s"}
"""Options that a task decides."""
DEFAULT = OpenLoopSearch()


@app.command()
@clear_errors
def main(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Card of the profile, a .json file.")],
    task: Annotated[
        str | None,
        typer.Option(
            help="Task of spoofgym-bench-v1, T1 to T6, which decides detector, scenario, attack "
            "and times."
        ),
    ] = None,
    detector: Annotated[
        str, typer.Option(help="Detector: a name, with settings as name:key=value or JSON.")
    ] = "ewma",
    scenario: Annotated[str, typer.Option(help="Scenario, likewise.")] = "zhong2025",
    attack: Annotated[str, typer.Option(help="Attack, likewise.")] = "false-position",
    heading: Annotated[
        float, typer.Option(help="Direction of the profile, in degrees clockwise from north.")
    ] = 90.0,
    knots: Annotated[int, typer.Option(help="Knots of the curve, 2 to 64.")] = DEFAULT.knots,
    generations: Annotated[int, typer.Option(help="Of the search.")] = DEFAULT.generations,
    population: Annotated[
        int, typer.Option(help="Candidates of a generation.")
    ] = DEFAULT.population,
    runs: Annotated[int, typer.Option(help="Runs of the search.")] = DEFAULT.runs,
    batch: Annotated[
        int, typer.Option(help="Runs that a generation plays, in turn; all of them at most.")
    ] = DEFAULT.batch,
    select_runs: Annotated[
        int, typer.Option(help="Training runs, on which amplitudes are fitted; at least 59.")
    ] = 512,
    score_runs: Annotated[int, typer.Option(help="Evaluation runs.")] = RUNS,
    seed: Annotated[int, typer.Option(help="All chance follows from this number.")] = 0,
    warmup_s: Annotated[float, typer.Option(help="Clean run before the attack, in seconds.")] = 200,
    live_s: Annotated[float, typer.Option(help="Its last part, with the detector live.")] = 180.0,
    attack_s: Annotated[float, typer.Option(help="Command phase, in seconds.")] = 150.0,
    time_to_alert_s: Annotated[float, typer.Option(help="Time to alert, in seconds.")] = 10.0,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads of the engine. Default: as many as pay.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume/--overwrite", help="Go on with a search that was interrupted.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else.")] = False,
) -> None:
    """Search for the open-loop profile that gets farthest within an alarm budget."""
    _check_out(out, resume)
    settings = OpenLoopSearch(
        runs=runs,
        batch=batch,
        knots=knots,
        population=population,
        generations=generations,
        seed=seed,
    )
    if task is None:
        times = Timeline(
            warmup_s=warmup_s, live_s=live_s, attack_s=attack_s, time_to_alert_s=time_to_alert_s
        )
        world = {"scenario": parse_spec(scenario), "attack": parse_spec(attack), "timeline": times}
        guard = parse_spec(detector)
    else:
        refuse_overrides("--task", list_passed_options(context, DECIDED).values())
        world, guard = get_task(task).world_kwargs, get_task(task).detector
    entries = [specify_detector(guard)]
    calibrate_players(World.of(**world), entries, threads=threads, progress=progress)
    sizes = {"runs": score_runs, "fit_runs": select_runs, "entropy": seed, "threads": threads}
    judge = Evaluator(detector=guard, **sizes, **world)
    judge.optima.settings = settings
    config = {**describe_identity(judge), "search": asdict(settings), "heading_deg": heading}
    folder = out.with_suffix(".search")
    if not resume:
        Store(folder).open("profile", config, overwrite=True)
    fits = {
        name: TuningResult.from_dict(each)
        for name, each in build_experiment(judge, heading, config).play(folder, progress).items()
    }
    card = make_card(judge, fits, heading, out.stem, _command(context))
    card.save(out)
    shutil.rmtree(folder)
    if as_json:
        print_json(card.model_dump())
        return
    title = (
        f"{select_runs} training runs against {judge.detector.label}; of those that are silent "
        f"without attack at most {100 * judge.optima.tuning.budget:g} % may alarm, by the upper "
        "95 % limit"
    )
    RIVALS.print(title, card.rivals)
    typer.echo(f"written: {out}")


def build_experiment(judge: Evaluator, heading: float, config: dict[str, Any]) -> Records:
    """A cell for every spoofer that is fitted; the search is in that of the open-loop attack."""

    def make_part(name: str, setting: str) -> Part:
        def make(_: Any, context: Context) -> dict[str, Any]:
            judge.progress = Ticks(context.tick)
            return judge.fit({"name": name, setting: "tuned", "heading_deg": heading}).as_dict()

        return Part({}, make, work=search_work(judge.optima.tuning, judge.runs))

    return Records("profile", config, {each[0]: make_part(*each) for each in FITTED.items()})


def make_card(
    judge: Evaluator, fits: dict[str, TuningResult], heading: float, name: str, command: str
) -> SpooferCard:
    """Card of what a search found, with its score."""
    best, setup = fits[SEARCHED], judge.world.setup
    if not best.within_budget or best.found is None:
        raise ValueError(
            f"no profile is within the alarm budget: the slowest one alarms in "
            f"{100 * best.chosen.alarm_rate:.1f} % of the {best.counted} runs that are silent "
            f"without attack, which may be {100 * best.chosen.alarm_limit:.1f} %; choose more runs"
        )
    limit, _ = get_rate_limits(setup)
    rates = np.clip(best.value * np.array(best.found["played"]["rates_mps"]), -limit, limit)
    designed_on = (
        f"{judge.detector.label}, {setup.attack.label}, scenario {setup.name}, "
        f"receiver tuning {setup.receiver.tuning}"
    )
    profile = {
        "heading_deg": heading,
        "rates_mps": rates.tolist(),
        "cross_rates_mps": [],
        "label": name,
        "designed_on": designed_on,
    }
    fields, search = describe_context(spoofer_context(setup)), judge.optima.settings
    kwargs = {
        "receiver": {},
        **describe(judge.world.settings),
        "detector": judge.detector.spec,
        "attack": dict(judge.world.config["attack"]),
        "action": {"name": "full-command"},  # of any rate that the attack allows
        "timeline": {k: v for k, v in judge.world.config["timeline"].items() if k != "kind"},
        "knowledge": "blind",
        "target_heading_deg": heading,
    }
    training = {
        "algorithm": "CMA-ES",
        "command": command,
        "seed": judge.entropy,
        "arguments": {**asdict(search), "select_runs": best.runs},
        DECIDED_ON: [[judge.entropy, "training"], [judge.entropy, SPLIT]],
        "choice": {**asdict(best.chosen), "found": best.found},
    }
    return SpooferCard.model_validate(
        {
            "name": name,
            "kind": "profile",
            "env_id": PLAIN_ID,
            "env_kwargs": kwargs,
            "observation": None,
            "action": fields["action"],
            "conditions": fields["conditions"],
            "knowledge": {"run_time": "blind", "design_time": designed_on},
            "training": training,
            "versions": {"spoofgym": __version__, **code_identity(("cmaes",))},
            "scores": [on_card(judge.score({"name": "profile", **profile}, amplitude=None), judge)],
            "rivals": [_rival(fit) for fit in fits.values()],
            "settings": profile,
            "file": None,
        }
    )


def _rival(fit: TuningResult) -> dict[str, Any]:
    numbers = asdict(fit.chosen)
    own = ("alarm_rate", "alarm_limit", "stealthy_displacement_m", "within_budget")
    name = f"{fit.spoofer}: {fit.setting} = {fit.value:g}"
    return {"spoofer": name, **{key: numbers[key] for key in own}, "tuning": fit.as_dict()}


def _check_out(out: Path, resume: bool) -> None:
    if out.suffix != ".json":
        raise ValueError(f"`out` must be a .json file, got {out}")
    if not re.fullmatch(NAME, out.stem):
        raise ValueError(
            "`out` names the profile, so that it must begin with a letter or a digit, and have "
            f"only letters, digits, '.', '_' and '-', got {out.name!r}"
        )
    if resume and out.exists():
        raise ValueError(f"{out} exists; --overwrite replaces it, or choose another --out")


def _command(context: typer.Context) -> str:
    """Command line that makes the card again, in the folder of its file."""
    words = ["python", "-m", "baselines.profile"]
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if name not in HIDDEN_OPTIONS and source is not None and source.name == "COMMANDLINE":
            value = context.params[name]
            words += [option.opts[0], value.name if name == "out" else str(value)]
    return shlex.join(words)


if __name__ == "__main__":
    app()
