"""Every epoch of an environment as Parquet files, one for every episode of a receiver.

A file holds the epochs of the commands: neither the warm-up, nor the time to alert after the last
command.  It is written as a whole when its episode is over, so that a run that is broken off leaves
whole files; a later run into the same folder counts on.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import remove_stale_parts, write_file
from ..detectors import Verdict
from .core import SpoofCore
from .terms.termination import EpochState

Array = NDArray[Any]
PATTERN = re.compile(r"receiver-(\d+)-episode-(\d+)\.parquet")


class EpochRecorder:
    """Recorder of the receivers of a core, into a folder that it makes; a `Listener`."""

    def __init__(self, folder: str | Path, receivers: int) -> None:
        if importlib.util.find_spec("pyarrow") is None:
            raise ImportError("recording needs pyarrow; install it with the extra `flights`")
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"`folder` {str(folder)!r} can't be made: {error}") from error
        if not os.access(self.folder, os.W_OK | os.X_OK):
            raise ValueError(f"nothing can be written into the `folder` {str(folder)!r}")
        remove_stale_parts(self.folder)
        self._episode = np.zeros(receivers, dtype=np.int64)
        for path in self.folder.glob("*.parquet"):
            found = PATTERN.fullmatch(path.name)
            if found is not None and int(found[1]) < receivers:
                row = int(found[1])
                self._episode[row] = max(self._episode[row], int(found[2]) + 1)
        self._rows: list[dict[str, list[Array]]] = [{} for _ in range(receivers)]
        self._satellites: tuple[str, ...] = ()
        self._pool: dict[str, int] = {}

    def __call__(self, core: SpoofCore, state: EpochState, verdict: Verdict) -> None:
        simulator = state.snapshot.simulator
        epoch = simulator.epoch
        self._satellites = getattr(core.setup.world, "satellite_ids", ())
        pool = core.engine.warm_pool
        self._pool = {} if pool is None else {"warm_pool": pool}
        columns: dict[str, Array] = {
            "time_s": epoch.time,
            "step": state.snapshot.step,
            "displacement_m": state.displacement,
            "alarm": np.logical_or.reduce(verdict.alarm, axis=1),
            "statistic": verdict.statistic,
            "threshold": verdict.threshold,
            "innovation": epoch.innovation,
            "innovation_variance": epoch.innovation_variance,
            "visible": epoch.visible,
            **simulator.recorded(),
        }
        for row in np.flatnonzero(~core.score.ended):
            kept = self._rows[row]
            for name, array in columns.items():
                kept.setdefault(name, []).append(np.array(array[row]))

    def finish(self, rows: NDArray[np.intp], *, complete: bool) -> list[Path]:
        """Write the episodes of some receivers, of those that have an epoch; start new ones."""
        written = []
        for row in rows.tolist():
            if not self._rows[row]:
                continue
            name = f"receiver-{row:03d}-episode-{self._episode[row]:06d}.parquet"
            head = {
                "receiver": row,
                "episode": int(self._episode[row]),
                "complete": complete,
                "satellite_ids": list(self._satellites),
                **self._pool,
            }
            write_file(self.folder / name, as_parquet(self._rows[row], head))
            written.append(self.folder / name)
            self._rows[row] = {}
            self._episode[row] += 1
        return written


def as_parquet(columns: dict[str, list[Array]], head: dict[str, Any]) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {}
    for name, values in columns.items():
        stacked = np.stack(values)
        if not stacked.size:  # a receiver that takes positions has no satellites in view
            continue
        flat = pa.array(stacked.reshape(-1))
        if stacked.ndim > 1:
            flat = pa.FixedSizeListArray.from_arrays(flat, stacked.shape[1])
        arrays[name] = flat
    table = pa.table(arrays).replace_schema_metadata({"spoofgym": json.dumps(head)})
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()
