"""The page of a game of populations: matrix, mixes, and how far they can be exploited."""

from __future__ import annotations

from typing import Any

from spoofgym.bench.tables import interval


def page_of(results: dict[str, Any]) -> str:
    """Results as a page: matrix, mixes, both ends of the exploitability."""
    last, config = results["iterations"][-1], results["config"]
    lines = [f"# The game in the world of {config['task']}", ""]
    final = results["final"]
    mixed = "A single detector solves this game" if last["pure"] else "No single detector solves it"
    lines += [
        f"{mixed}: its value is {interval(last['spread']['value'], 3)}. On fresh runs the best "
        f"response to the mix of detectors gets {interval(final['mix'], 3)}, and that to "
        f"{final['single']} alone {interval(final['alone'], 3)}: mixing saves "
        f"{interval(final['gain_of_mixing'], 3)}.",
        "",
        *matrix_table(last),
        "",
        "| iteration | value | gain of a spoofer, from below | from above | gain of a detector, "
        "from below | both, from below |",
        "|---|---|---|---|---|---|",
    ]
    for k, each in enumerate(results["iterations"]):
        ends = each["exploitability"]
        above = ends["spoofer"]["above"]
        shown = f"{'none' if above is None else f'{above:.3f}'}: {ends['spoofer']['why']}"
        cells = [
            interval(each["spread"]["value"], 3),
            f"{interval(ends['spoofer']['below'], 3)}, {ends['spoofer']['member']}",
            shown,
            f"{interval(ends['detector']['below'], 3)}, {ends['detector']['member']}",
            interval(ends["below"], 3),
        ]
        lines.append(f"| {k} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def matrix_table(found: dict[str, Any]) -> list[str]:
    """Table of a matrix, with what each spoofer observes, and the mixes of both sides."""
    matrix, spread = found["matrix"], found["spread"]
    names = [each["label"] for each in matrix["detectors"]]
    lines = [
        f"| spoofer | observes | mix | {' | '.join(names)} |",
        "|---|---|---|" + "---|" * len(names),
        f"| **mix** | | | {' | '.join(interval(p, 2) for p in spread['detector'])} |",
    ]
    for who, p, row in zip(matrix["spoofers"], spread["spoofer"], matrix["values"], strict=True):
        cells = " | ".join(f"{value:.3f}" for value in row)
        lines.append(f"| {who['label']} | {who['knowledge']} | {interval(p, 2)} | {cells} |")
    return lines
