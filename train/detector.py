"""Train a detector on a data set of labelled episodes, and export it.

    spoofgym dataset runs/data --task T3
    python -m train.detector --data runs/data --out runs/guard

1. A network (`agents.detector_network`), recurrent or of a bounded past, learns by two losses
   (`agents.detector_loss`): the logistic loss of every epoch, the best statistic of an epoch at any
   rate of false alarms (Neyman and Pearson); and what is scored, made smooth, since alarms come
   from the largest of hundreds of epochs, and rare ones decide.
2. After every pass it plays the validation runs by the rule of the benchmark.  The best network is
   kept, and training stops when none has been better for `--patience` passes.
3. The best one is written as `NAME.onnx`, recurrent, with its card, and plays the test runs, once.

A threshold that can be trusted comes from many more clean runs: `spoofgym calibrate`.  The folder
holds `config.json`, `record.jsonl` (one line a pass), `checkpoint.pt`, the detector and its card.
After a kill the same command goes on from the last pass, to the same result.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from rich.console import Console

from agents.checkpoint import open_checkpoint, write_checkpoint
from agents.detector_loss import compute_undetected, logistic
from agents.detector_network import NETWORKS, compute_statistic, count_parameters
from agents.detector_score import Scored, count_live, score_non_learned, score_statistic, window_s
from agents.folder import error_lines, learning_versions
from agents.record import read_record, write_record
from spoofgym import export
from spoofgym.bench.experiments import Store
from spoofgym.bench.experiments.dataset import Dataset, Episodes, load_dataset
from spoofgym.core.declared import check_number
from spoofgym.core.progress import show_progress
from spoofgym.core.reading import name_file
from spoofgym.core.registry import check_choice, whole_number
from spoofgym.detectors.calibration_file import check_runs
from spoofgym.policies.card import DECIDED_ON


@dataclass(frozen=True)
class Arguments:
    """Settings of a training; all but `threads` belong to its identity."""

    data: Path  # Folder of the data set, of `spoofgym dataset`.
    out: Path  # Folder of the training; its last part is the name of the detector.
    passes: int = 10  # Largest number of passes through the data.
    patience: int = 4  # Passes without a better validation after which it stops.
    keep_last: bool = False  # Keep the last pass: of few clean runs a validation is noise.
    batch_size: int = 64  # Episodes of a minibatch.
    learning_rate: float = 5e-3  # At first; it falls as a cosine, to 0 at the last pass.
    weight_decay: float = 1e-4  # Of AdamW.
    clip_norm: float = 1.0  # Largest norm of a gradient.
    network: str = "recurrent"  # Or "window", which has a bounded past; it takes `filter-shift`.
    width: int = 32  # Units of the recurrent unit, or of each layer of the other network.
    projections: int = (
        8  # Vectors onto which innovations are projected, or combinations of windows.
    )
    past_s: float | None = None
    """Longest time before the onset at which a minibatch begins, and that of validation runs; the
    default begins at one moment since switch-on for all its episodes, which with drawn ages are
    long."""
    least_live_s: float = 10.0
    """Every minibatch begins at a drawn moment, at least so long before the first onset: where a
    world draws no ages all attacks start at one epoch, and a network that remembers could count."""
    emphasis: float = 3.0  # Weight of what is scored, beside the logistic loss.
    false_alarms_per_hour: float = 0.2  # Rate of false alarms at which it is validated.
    seed: int = 0  # Seed of the random number generators.
    threads: int = 1  # Threads of torch; on a busy machine two are slower than one.

    def __post_init__(self) -> None:
        for name in ("passes", "patience", "batch_size", "width", "projections", "threads"):
            whole_number(f"`{name}`", getattr(self, name), 1)
        for name in ("learning_rate", "clip_norm", "false_alarms_per_hour", "least_live_s"):
            check_number(name, getattr(self, name), above=0.0)
        check_choice("network", self.network, NETWORKS)
        if self.past_s is not None:
            check_number("past_s", self.past_s, least=self.least_live_s)
        for name in ("emphasis", "weight_decay", "seed"):
            check_number(name, getattr(self, name), least=0.0)
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", self.out.name):
            raise ValueError(f"the last part of `out` names the detector, got {str(self.out)!r}")

    @property
    def identity(self) -> dict[str, Any]:
        """What a resumed training shares with the interrupted one; JSON-able."""
        free = ("threads", "out", "data")
        return {name: value for name, value in asdict(self).items() if name not in free}


class Trainer:
    """One training: network, optimizer, and the best so far."""

    def __init__(self, given: Arguments, data: Dataset) -> None:
        self.args, self.data, self.config = given, data, data.config
        torch.set_num_threads(given.threads)
        torch.manual_seed(given.seed)
        self.network = NETWORKS[given.network](
            data.names, self.config["interval_s"], given.width, given.projections
        )
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=given.learning_rate, weight_decay=given.weight_decay
        )
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimizer, given.passes)
        self.done, self.best, self.best_pass = 0, math.inf, 0
        self.best_weights: dict[str, torch.Tensor] = {}

    def normalize(self, episodes: Episodes) -> None:
        """Centre and scale, of clean training runs."""
        some = episodes.clean, slice(None, None, 7)
        clean = episodes.observation[some][episodes.valid[some]]
        self.network.normalize_by(clean.astype(np.float32))

    def learn(self, episodes: Episodes) -> float:
        """One pass through the training episodes.  Returns the mean loss."""
        rng = np.random.default_rng([self.args.seed, self.done])
        order = rng.permutation(len(episodes.clean))
        size, losses = self.args.batch_size, []
        interval, past_s = self.config["interval_s"], self.args.past_s
        least = math.ceil(self.args.least_live_s / interval)
        latest = max(int(count_live(episodes, self.config).min()) - least, 0)
        longest = 0 if past_s is None else max(math.ceil(past_s / interval), least)
        starts = range(0, len(order), size)
        with show_progress(len(starts), start=f"pass {self.done + 1}") as bar:
            for start in starts:
                rows = np.sort(order[start : start + size])
                some, begin = Episodes(*(part[rows] for part in episodes)), 0
                if longest:
                    some = cut_episodes(some, int(rng.integers(least, longest + 1)), self.config)
                else:
                    begin = int(rng.integers(latest + 1))
                loss = self._loss(some, begin)
                self.optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.args.clip_norm)
                self.optimizer.step()
                losses.append(float(loss.detach()))
                bar.advance(1.0, f"pass {self.done + 1}")
                if not math.isfinite(losses[-1]):
                    break
        self.schedule.step()
        self.done += 1
        return float(np.mean(losses))

    def _loss(self, some: Episodes, begin: int) -> torch.Tensor:
        """Loss of some episodes, from an epoch before the onset on."""
        seen = torch.from_numpy(some.observation[:, begin:].astype(np.float32))
        odds = self.network.log_odds(seen)
        moved = torch.from_numpy(some.displacement_m[:, begin:]) / self.config["length_m"]
        moved, clean = moved.clamp(max=1.0), torch.from_numpy(some.clean)
        attack, valid = (torch.from_numpy(part[:, begin:]) for part in (some.attack, some.valid))
        loss = logistic(odds, attack, moved, valid)
        if clean.all() or not clean.any():  # a small rest of a pass
            return loss
        live = torch.from_numpy(count_live(some, self.config) - begin)
        found = compute_undetected(odds, moved, clean, live, self.config["epochs"])
        return loss + self.args.emphasis * found

    def score(self, episodes: Episodes) -> Scored:
        """Play some runs; a network whose answers are not all finite has an infinite loss."""
        with torch.no_grad():
            odds = [
                self.network.log_odds(torch.from_numpy(part.astype(np.float32))).numpy()
                for part in np.array_split(
                    episodes.observation, math.ceil(len(episodes.clean) / 64)
                )
            ]
        with np.errstate(invalid="ignore"):
            raw = compute_statistic(np.concatenate(odds))
        statistic, rate = np.nan_to_num(raw, nan=1.0), self.args.false_alarms_per_hour
        found = score_statistic(statistic, episodes, self.config, rate)
        return found if np.isfinite(raw).all() else found._replace(loss=math.inf)

    def keep(self, loss: float) -> None:
        if loss < self.best or (self.args.keep_last and math.isfinite(loss)):
            self.best, self.best_pass = loss, self.done
            self.best_weights = {key: x.clone() for key, x in self.network.state_dict().items()}

    def save(self, path: Path) -> None:
        tensors = {name: getattr(self, name).state_dict() for name in PARTS}
        state = {name: getattr(self, name) for name in COUNTS}
        write_checkpoint(path, {**tensors, "kept": self.best_weights}, state)

    def restore(self, path: Path) -> None:
        with open_checkpoint(path) as (tensors, state):
            for name in PARTS:
                getattr(self, name).load_state_dict(tensors[name])
            self.best_weights = tensors["kept"]
            for name in COUNTS:
                setattr(self, name, state[name])


def cut_episodes(episodes: Episodes, before: int, config: Mapping[str, Any]) -> Episodes:
    """Episodes from so many epochs before the onset on, or from switch-on where that is later."""
    begin = np.maximum(count_live(episodes, config) - before, 0)
    length = before + config["epochs"]["steps"] + config["epochs"]["hold"]
    at = np.minimum(begin[:, None] + np.arange(length), episodes.attack.shape[1] - 1)
    rows = np.arange(len(begin))[:, None]
    cut = episodes._replace(
        observation=episodes.observation[rows, at],
        attack=episodes.attack[rows, at],
        displacement_m=episodes.displacement_m[rows, at],
        epochs=episodes.epochs - begin,
    )
    return cut._replace(attack=cut.attack & cut.valid)


PARTS, COUNTS = ("network", "optimizer", "schedule"), ("done", "best", "best_pass")


def train(given: Arguments, console: Console) -> Path:
    """Train, or go on, and export the best.  Returns the ONNX file."""
    data = load_dataset(given.data)
    config = {**given.identity, "name": given.out.name, "data": data.digest}
    validation, episodes = data.episodes("validation"), data.episodes("train")
    if given.past_s is not None:  # which is what is learned from, too, and a part of hours
        longest = math.ceil(given.past_s / data.config["interval_s"])
        validation = cut_episodes(validation, longest, data.config)
    test = data.episodes("test")  # or that it is damaged; it is used in the end
    clean = int(validation.clean.sum())
    for part, runs in (("validation", clean), ("test", int(test.clean.sum()))):
        with name_file(f"{given.data}, part {part}"):
            check_runs(given.false_alarms_per_hour, runs, window_s(data.config), tail=False)
    trainer, started = Trainer(given, data), time.monotonic()
    Store(given.out).open("detector", {**config, "versions": learning_versions()})
    checkpoint = given.out / CHECKPOINT
    if checkpoint.is_file():
        trainer.restore(checkpoint)
    if trainer.done == 0:
        trainer.normalize(episodes)
    console.print(
        f"{len(episodes.clean)} episodes, {count_parameters(trainer.network)} weights; validation "
        f"on {clean} runs, at {given.false_alarms_per_hour:g} false alarms an hour"
    )
    path = given.out / RECORD
    points = read_record(path) if path.is_file() else []
    points = [point for point in points if point["step"] <= trainer.done]
    while trainer.done < given.passes and trainer.done - trainer.best_pass < given.patience:
        loss = trainer.learn(episodes)
        if not math.isfinite(loss):
            console.print(
                f"[red]pass {trainer.done} diverged (loss {loss}): the best before it is kept; "
                f"a smaller --learning-rate than {given.learning_rate:g} may help"
            )
            break
        found = trainer.score(validation)
        trainer.keep(found.loss)
        values = {name: x for name, x in found._asdict().items() if math.isfinite(x)}
        told = {"step": trainer.done, "wall_s": time.monotonic() - started, "train_loss": loss}
        points.append({**told, **values})
        write_record(path, points)
        trainer.save(checkpoint)
        console.print(
            f"pass {trainer.done}: loss {loss:.4f}; undetected {found.mean_m:.2f} m, "
            f"scored {found.loss:.4f}{' (best)' if trainer.best_pass == trainer.done else ''}, "
            f"area {found.area:.4f}"
        )
    return _export(trainer, console)


def _export(trainer: Trainer, console: Console) -> Path:
    """Write the best network and its card, and play the test runs."""
    if not trainer.best_weights:
        raise ValueError("training diverged before any pass was good: there is nothing to keep")
    given, config = trainer.args, trainer.config
    trainer.network.load_state_dict(trainer.best_weights)
    episodes = trainer.data.episodes("test")
    test, rate = trainer.score(episodes), given.false_alarms_per_hour
    classics = score_non_learned(trainer.data, episodes, rate)
    path = given.out / f"{given.out.name}.onnx"
    training = {
        "algorithm": "supervised, weighted logistic loss of every epoch",
        "data": trainer.data.digest,
        "task": config["task"],
        "families": config["families"],
        "held_out": config["held_out"],
        DECIDED_ON: [[config["entropy"], f"dataset-{part}"] for part in ("train", "validation")],
        "passes": trainer.done,
        "best_pass": trainer.best_pass,
        "validation": trainer.best,
        "test": test.loss,
        "test_of_classics": {name: each.loss for name, each in classics.items()},
        **given.identity,
    }
    export.detector(
        trainer.network.eval(),
        path,
        name=given.out.name,
        terms=config["terms"],
        state=trainer.network.state,
        interval_s=config["interval_s"],
        channels=trainer.network.channels,
        training=training,
    )
    console.print(f"best: pass {trainer.best_pass}; the test runs, each by its own threshold:")
    for name, each in {given.out.name: test, **classics}.items():
        console.print(f"  {name}: {each.mean_m:.2f} m undetected, scored {each.loss:.4f}")
    console.print(str(path), soft_wrap=True)
    return path


RECORD, CHECKPOINT = "record.jsonl", "checkpoint.pt"


@error_lines()
def main() -> None:
    train(tyro.cli(Arguments, description=__doc__), Console())


if __name__ == "__main__":
    main()
