"""Detectors of an outsider that cheat or fail, each by one trick.

Every process of one imports this file: what takes long is imported where it is needed.
"""

import contextlib
import ctypes
import gc
import os
import re
import sys
import time
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from spoofgym.detectors import Detector, Never, Verdict

MARK = re.compile(rb"ENTROPY-IS-(\d{20})")
RUNS = 4
PIECE = 1 << 24
"""Bytes of memory that are searched at a time."""


class Outsider(Detector):
    """Alarms where `find` does; `epochs` (B,) judged so far."""

    paper = "vovk2005"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("epochs", np.zeros(context.receivers, dtype=np.int64))

    def find(self, epoch):
        return np.zeros(len(epoch.time), dtype=np.bool_)

    def judge(self, epoch):
        self.memory["epochs"] = self.memory["epochs"] + 1
        alarm = np.array(self.find(epoch)).reshape(-1, 1)
        return Verdict(alarm.astype(float), np.full(alarm.shape, 0.5), alarm)


def attacks(thing):
    """Whether an object commands an attack."""
    return type(thing).__name__ == "SpooferController" and thing._parts[0].spec != "none"


class Frames(Outsider):
    def find(self, epoch):
        frame, found = sys._getframe(), False
        while frame is not None:
            found |= any(map(attacks, frame.f_locals.values()))
            frame = frame.f_back
        return np.full(len(epoch.time), found)


class Collected(Outsider):
    def find(self, epoch):
        looks = self.memory["epochs"].max() % 20 == 0  # which takes long in a large process
        return np.full(len(epoch.time), looks and any(map(attacks, gc.get_objects())))


class Wrapped(Outsider):
    """A wrapper around a stand-in environment, whose information has the epochs, that alarms where
    its environment, the reward or an object of the process tells of an attack."""

    def __init__(self):
        import_module("spoofgym.wrappers.streams")  # once, before any batch

    def bind(self, context):
        import gymnasium as gym

        from spoofgym.wrappers.streams import StreamEnv

        class CheatingWrapper(gym.Wrapper):
            def step(self, action):
                *seen, info = self.env.step(action)
                found = seen[1] != 0.0 or hasattr(self.env.unwrapped, "core")
                found |= any(map(attacks, gc.get_objects()))
                assert len(info["epochs"]) == 1
                return *seen, {**info, "alarm": found}

        super().bind(context)
        box = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
        inner = SimpleNamespace(observation_space=box, action_space=box, metadata={})
        self.env = CheatingWrapper(StreamEnv(inner))

    def find(self, epoch):
        if self.memory["epochs"].max() % 20:
            return super().find(epoch)
        from spoofgym.receiver.epoch import select_receiver
        from spoofgym.wrappers.streams import Stream

        self.env.unwrapped.feed.streams = [Stream((), (select_receiver(epoch, 0),), 0)]
        self.env.unwrapped.feed.at = -1
        return np.full(len(epoch.time), self.env.step(np.zeros(2))[4]["alarm"])


class Proc(Outsider):
    """Looks for secrets in the memory of its process and of those above it."""

    def find(self, epoch):
        if self.memory["epochs"].max() == 1:
            self.secret = bool(self.search())
        return np.full(len(epoch.time), self.secret)

    def search(self):
        """Numbers that are marked as secret."""
        pid, found = "self", set()
        while pid != "0":
            found |= self.read(pid)
            with contextlib.suppress(OSError):
                status = Path(f"/proc/{pid}/status").read_text()
                pid = re.search(r"PPid:\s(\d+)", status)[1]
                continue
            break
        return found

    def read(self, pid):
        found = set()
        with contextlib.suppress(OSError), open(f"/proc/{pid}/mem", "rb", 0) as memory:
            for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
                first, last = (int(each, 16) for each in line.split()[0].split("-"))
                if " rw-p " not in line:
                    continue
                for start in range(first, last, PIECE):  # the kernel joins what lies side by side
                    with contextlib.suppress(OSError, ValueError):
                        memory.seek(start)
                        piece = memory.read(min(PIECE + 64, last - start))
                        found.update(map(int, MARK.findall(piece)))
        return found


RECORDED, ENTROPIES = set(), set()


class Recorder(Outsider):
    """Keeps all innovations that it sees."""

    def find(self, epoch):
        RECORDED.update(row.tobytes() for row in epoch.innovation)
        return super().find(epoch)


@cache
def list_clean_rows(build_setup, entropy):
    """Innovations of the clean runs of an entropy."""
    from spoofgym.bench.runs.panel import generators
    from spoofgym.bench.runs.play import WarmStart, play

    RECORDED.clear()
    setup = build_setup().copy_with(detector=Recorder())
    rngs = generators(setup, entropy, "evaluation", np.arange(RUNS))
    play(WarmStart(setup, rngs, threads=1), "none")
    return frozenset(RECORDED)


class PublicSeeds(Outsider):
    """Plays the clean runs of entropies 0 to 9 once, and alarms where one that it knows goes
    another way."""

    def __init__(self):
        self.list_rows()

    def bind(self, context):
        super().bind(context)
        self.memory.declare("known", np.zeros(context.receivers, dtype=np.bool_))

    def find(self, epoch):
        rows, known = self.list_rows(), self.memory["known"]
        here = np.array([row.tobytes() in rows for row in epoch.innovation])
        self.memory["known"] = known | here
        return known & ~here

    def list_rows(self):
        each = (list_clean_rows(self.build_setup, entropy) for entropy in self.list_entropies())
        return frozenset().union(*each)

    def list_entropies(self):
        return range(10)

    @staticmethod
    def build_setup():
        from ..simulation.support import setup_of

        return setup_of("tightly-coupled", detector=Never())


class PublicSeedsOfTask(PublicSeeds):
    """The same in the world of a task."""

    @staticmethod
    def build_setup():
        from spoofgym.bench.runs.world import World

        from ..bench.detector_support import small_task

        return World(settings=small_task().world_kwargs).setup


class ProcOfTask(PublicSeedsOfTask, Proc):
    """The same with the entropies that it finds in the memory of processes."""

    def __init__(self):
        ENTROPIES.update(self.search())
        super().__init__()

    def list_entropies(self):
        return ENTROPIES


SEEN = {}


class Memorizer(Outsider):
    """Stores runs in a global, and alarms where a run with the same start goes another way."""

    def bind(self, context):
        super().bind(context)
        self.memory.declare("start", np.zeros(context.receivers))

    def find(self, epoch):
        self.memory["start"] = np.where(
            self.memory["epochs"] == 1, epoch.innovation[:, 0], self.memory["start"]
        )
        keys = zip(self.memory["start"], self.memory["epochs"], strict=True)
        rows = [row.tobytes() for row in epoch.innovation]
        return [SEEN.setdefault(k, row) != row for k, row in zip(keys, rows, strict=True)]


WAYS = (
    *("raises", "nan", "shape", "undeclared", "leaves", "quits", "truncates", "lies"),
    *("forks", "swarms", "hangs", "writes"),
)
FIRST_WAY = 1000
"""In the second innovation of all receivers: one process, which starts slowly, has all ways."""


@dataclass
class Fails(Outsider):
    """Fails from its third epoch on, in one way: its setting, or what the epoch says."""

    how: str = "raises"

    def judge(self, epoch):
        verdict = super().judge(epoch)
        if self.memory["epochs"][0] >= 3:
            way = int(epoch.innovation[0, 1]) - FIRST_WAY
            how = WAYS[way] if 0 <= way < len(WAYS) else self.how
            return getattr(self, how)(epoch, verdict)
        return verdict

    def raises(self, epoch, verdict):
        if (epoch.innovation[:, 0] > 50.0).any():
            raise ArithmeticError("too much")
        return verdict

    def nan(self, epoch, verdict):
        verdict.statistic[2] = np.nan
        return verdict

    def shape(self, epoch, verdict):
        return verdict._replace(alarm=verdict.alarm[:2])

    def undeclared(self, epoch, verdict):
        return verdict._replace(statistic=epoch.design[:, :1, 0])

    def writes(self, epoch, verdict):
        address, _ = epoch.innovation.__array_interface__["data"]
        ctypes.memset(address, 0, epoch.innovation.nbytes)
        return verdict

    def hangs(self, epoch, verdict):
        time.sleep(60.0)

    def leaves(self, epoch, verdict):
        os._exit(0)

    def quits(self, epoch, verdict):
        sys.exit(3)

    def truncates(self, epoch, verdict):
        for handle in range(3, 64):
            try:
                os.ftruncate(handle, 0)
            except PermissionError:  # of a sealed file
                raise
            except OSError:
                continue
        return verdict

    def lies(self, epoch, verdict):
        for each in gc.get_objects():
            if type(each).__name__ == "Channel":
                with contextlib.suppress(OSError):
                    each.send(b"!" + b"[" * 100_000)
        return verdict

    def forks(self, epoch, verdict):
        os.fork()
        return verdict

    def flees(self, epoch, verdict):
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                time.sleep(60.0)
            os._exit(0)
        return verdict

    def swarms(self, epoch, verdict):
        for _ in range(9):
            if os.fork() == 0:
                time.sleep(60.0)
                os._exit(0)
        return verdict

    def prints(self, epoch, verdict):
        print("a word of the detector", flush=True)
        return verdict

    def floods(self, epoch, verdict):
        os.write(2, b"a word of the detector\n" * 10_000)
        return verdict
