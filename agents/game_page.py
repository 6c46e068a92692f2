"""The page of a game of populations: who plays whom, mixes, and how far they can be exploited."""

from __future__ import annotations

import json
import math
from statistics import fmean
from typing import Any

from spoofgym.bench.report.table import Table, interval
from spoofgym.core.registry import inspect_settings
from spoofgym.core.settings import describe
from spoofgym.detectors import DETECTORS
from spoofgym.spoofers.base import sees_statistics

TIGHTEST = 10
HEAD = (
    *("iteration", "value, {runs} runs of `game`", "value on fresh runs"),
    *("gain of a spoofer, from below", "from above", "gain of a detector, from below"),
)


def write_page(results: dict[str, Any]) -> str:
    found = select_results(results)
    pure = found["final"]["pure"]
    answer = "A single detector solves this game" if pure else "No single detector solves it"
    value = interval(found["iterations"][-1]["spread"], 3)
    why = [f"- {each}" for each in found["left_out"]]
    title = [f"# The game in the world of {found['config']['task']}", "", f"{answer}: {value}.", ""]
    left = ["", "Left out, and why:", "", *why] if why else []
    return "\n".join([*title, shown(found), *left]) + "\n"


def select_results(results: dict[str, Any]) -> dict[str, Any]:
    """What the page needs of `results.json`."""
    last = results["iterations"][-1]["matrix"]
    who, whom = ([each["label"] for each in last[f"{side}s"]] for side in ("spoofer", "detector"))
    iterations = []
    for found in results["iterations"]:
        spread, matrix, ends = found["spread"], found["matrix"], found["exploitability"]
        mixes = {
            side: {
                each["label"]: p
                for each, p in zip(matrix[f"{side}s"], spread[side], strict=True)
                if p["high"]
            }
            for side in ("spoofer", "detector")
        }
        told = {name: ends[name] for name in ("value", "spoofer", "detector")}
        pool = make_pool(found["detectors_mix"])
        known = {"spread": spread["value"], "pure": spread["pure"]}
        iterations.append({**known, "mixes": mixes, "ends": told, "pool": pool})
    final = results["final"]
    kept = ("pure", "single", "mix", "alone", "gain_of_mixing")
    return {
        "config": results["config"],
        "left_out": results["left_out"],
        "knowledge": {each["label"]: each["knowledge"] for each in last["spoofers"]},
        "detectors": whom,
        "values": dict(zip(who, last["values"], strict=True)),
        "iterations": iterations,
        "final": {name: final[name] for name in kept} | {"pool": make_pool(final["detectors_mix"])},
    }


def make_pool(mix: dict[str, Any]) -> dict[str, Any]:
    """A mix of detectors as a pool, without the settings that are defaults."""
    members = [_short(each["spec"]) for each in mix["members"]]
    return {"name": "pool", "members": members, "weights": [round(w, 4) for w in mix["weights"]]}


def _short(spec: dict[str, Any]) -> dict[str, Any]:
    kind: Any = DETECTORS.get(spec["name"])
    usual = {} if kind is None else {key: describe(x) for key, x in inspect_settings(kind).items()}
    return {key: x for key, x in spec.items() if key not in usual or usual[key] != x}


def shown(kept: dict[str, Any]) -> str:
    """Tables of the page: what spoofers gain from the detectors of the mixes, the detectors from
    which they gain the least, the iterations, and the mixes as pools."""
    first, last = kept["iterations"][0], kept["iterations"][-1]
    knowledge, turns = kept["knowledge"], len(kept["iterations"]) - 1
    who = sorted(kept["values"], key=lambda name: sees_statistics(knowledge[name]))
    mixes = [(f"mix, iteration {k}", found) for k, found in ((0, first), (turns, last))]
    names = [name for name, _ in mixes]
    values, detectors = kept["values"], kept["detectors"]
    mixed = [
        k for k, x in enumerate(detectors) if any(x in m["mixes"]["detector"] for _, m in mixes)
    ]
    spoofers = [
        (
            *(name, knowledge[name], *_weights(mixes, "spoofer", name)),
            *(_payoff(values[name][k]) for k in mixed),
        )
        for name in who
    ]
    columns = zip(*values.values(), strict=True)
    gains = [[x for x in each if x is not None] or [math.inf] for each in columns]
    order = sorted(range(len(detectors)), key=lambda k: fmean(gains[k]))[:TIGHTEST]
    tightest = [
        (
            *(detectors[k], *_weights(mixes, "detector", detectors[k])),
            *(_payoff(fmean(gains[k])), _payoff(max(gains[k]))),
        )
        for k in order
    ]
    against = (f"against {detectors[k]}" for k in mixed)
    ends = [
        (
            *(str(k), interval(found["spread"], 3), interval(found["ends"]["value"], 3)),
            f"{interval(found['ends']['spoofer']['below'], 3)}, "
            f"{found['ends']['spoofer']['member']}",
            _above(found["ends"]["spoofer"]["above"]),
            f"{interval(found['ends']['detector']['below'], 3)}, "
            f"{found['ends']['detector']['member']}",
        )
        for k, found in enumerate(kept["iterations"])
    ]
    titles = tuple(each.format(runs=kept["config"]["runs"]) for each in HEAD)
    final = kept["final"]
    lines = [
        Table.of_texts("spoofer", "observes", *names, *against).markdown(spoofers),
        "",
        f"The {len(order)} of {len(detectors)} detectors from which the spoofers gain the least in "
        "the mean:",
        "",
        Table.of_texts("detector", *names, "mean payoff", "largest").markdown(tightest),
        "",
        Table.of_texts(*titles).markdown(ends),
        "",
        f"On fresh runs the response that a last search chose to the last mix of detectors gets "
        f"{interval(final['mix'], 3)}, and that to {final['single']} alone "
        f"{interval(final['alone'], 3)}: mixing saves {interval(final['gain_of_mixing'], 3)}.",
        "",
        "The mixes of detectors as pools, of iteration 0 and the last one:",
        "",
        "```json",
        json.dumps(first["pool"]),
        json.dumps(final["pool"]),
        "```",
    ]
    return "\n".join(lines) + "\n"


def _weights(mixes: list[Any], side: str, name: str) -> list[str]:
    """Probability of a player in each of the mixes."""
    found = [mix["mixes"][side].get(name) for _, mix in mixes]
    return ["" if each is None else interval(each, 2) for each in found]


def _payoff(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _above(limit: float | None) -> str:
    return "none" if limit is None else f"{limit:.3f}"
