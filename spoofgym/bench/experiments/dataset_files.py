"""Data sets on disk: shards of episodes, and a manifest that says what they are."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.registry import check_choice
from ...core.settings import digest_of

FloatArray = NDArray[np.float64]
KIND, FORMAT = "spoofgym-dataset", 1
"""What a manifest is of; other arrays, or another meaning of one, are another format."""
MANIFEST = "manifest.json"
DAMAGED = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error)


class Episodes(NamedTuple):
    """Labelled episodes, L epochs each, from switch-on to the end of the time to alert.

    Attributes
    ----------
    observation : ndarray
        (E, L, o) float16, what a learned detector observes; the rounding is to 11 bits.
    attack : ndarray
        (E, L) bool, whether an attack is on.
    displacement_m : ndarray
        (E, L) float32, horizontal distance of the solution from that of the clean twin [m].
    clean : ndarray
        (E,) bool, whether nobody attacks.
    family : ndarray
        (E,) number of the attack's family in the manifest's ``families``; -1 where it is clean.
    setting : ndarray
        (E,) str, the attack's name and settings as JSON; "" where it is clean.
    run : ndarray
        (E,) run of the split; the two episodes of a run are twins.
    world : ndarray
        (E,) which of the manifest's ``skies``.
    onset_s : ndarray
        (E,) time of the flight at which the attack starts, or would [s].
    """

    observation: NDArray[np.float16]
    attack: NDArray[np.bool_]
    displacement_m: NDArray[np.float32]
    clean: NDArray[np.bool_]
    family: NDArray[np.int16]
    setting: NDArray[np.str_]
    run: NDArray[np.int64]
    world: NDArray[np.int64]
    onset_s: FloatArray


def packed(episodes: Episodes, digest: str) -> bytes:
    """A shard; the same bytes for the same episodes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, digest=np.array(digest), **episodes._asdict())
    return buffer.getvalue()


def digest_in(content: bytes) -> str | None:
    """Digest of the plan that a shard is of; None where it is damaged."""
    try:
        with np.load(io.BytesIO(content)) as found:
            return str(found["digest"])
    except DAMAGED:
        return None


def whole(content: bytes, digest: str) -> Episodes | None:
    """Episodes of a shard; None where it is damaged, or of another plan."""
    try:
        with np.load(io.BytesIO(content)) as found:
            if str(found["digest"]) != digest:
                return None
            return Episodes(*(found[name] for name in Episodes._fields))
    except DAMAGED:
        return None


def read_manifest(path: Path) -> dict[str, Any]:
    file = path / MANIFEST
    if not file.is_file():
        raise ValueError(
            f"{path} holds no {MANIFEST}: it is no data set, or one that is not finished, which "
            "`spoofgym dataset` with the same options goes on with"
        )
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"{file} is damaged: {error}") from error
    if not isinstance(found, dict) or found.get("kind") != KIND:
        raise ValueError(f"{file} is no manifest of a data set")
    if found.get("format") != FORMAT:
        raise ValueError(
            f"{file} has the format {found.get('format')!r}, and this version of spoofgym reads "
            f"{FORMAT}: write the data set again"
        )
    if digest_of(found.get("config")) != found.get("digest"):
        raise ValueError(f"{file} is damaged: its settings do not have its digest")
    return found


@dataclass(frozen=True)
class Dataset:
    """A data set on disk; shards are read, and checked, when they are asked for.

    Attributes
    ----------
    path : Path
        Its folder.
    manifest : dict
        As it was written: ``config`` with all settings, ``digest`` of it, and ``shards``.
    """

    path: Path
    manifest: dict[str, Any]

    @property
    def config(self) -> dict[str, Any]:
        """Settings of the data: world, epochs, observation, families, seeds.

        Returns
        -------
        dict
            Of the manifest.
        """
        return dict(self.manifest["config"])

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every element of an observation.

        Returns
        -------
        tuple of str
            (o,).
        """
        return tuple(self.config["observation"]["names"])

    def episodes(self, part: str) -> Episodes:
        """All episodes of a split.

        Parameters
        ----------
        part : str
            ``"train"``, ``"validation"`` or ``"test"``.

        Returns
        -------
        Episodes
            In the order of their runs.

        Raises
        ------
        ValueError
            Where there is no such split, or a shard is missing, damaged, or does not fit the
            manifest.
        """
        check_choice("split of this data set", part, self.manifest["shards"])
        shards = [self._shard(line) for line in self.manifest["shards"][part]]
        return Episodes(*(np.concatenate(arrays) for arrays in zip(*shards, strict=True)))

    def check(self, part: str) -> None:
        """Look whether all shards of a split are there and as they were written.

        Parameters
        ----------
        part : str
            As of `episodes`.

        Raises
        ------
        ValueError
            As of `episodes`.
        """
        check_choice("split of this data set", part, self.manifest["shards"])
        for line in self.manifest["shards"][part]:
            self._content(line)

    def _content(self, line: Mapping[str, Any]) -> bytes:
        file: Path = self.path / line["file"]
        if not file.is_file():
            raise ValueError(f"{file} is missing: write the data set again, which makes that shard")
        content = file.read_bytes()
        if hashlib.sha256(content).hexdigest() != line["sha256"]:
            raise ValueError(
                f"{file} is damaged: its SHA-256 is not that of the manifest; delete it and write "
                "the data set again, which makes that shard"
            )
        return content

    def _shard(self, line: Mapping[str, Any]) -> Episodes:
        found = whole(self._content(line), self.manifest["digest"])
        length = self.config["epochs"]["all"]
        shape = line["episodes"], length, len(self.names)
        if found is None or found.observation.shape != shape:
            raise ValueError(
                f"{self.path / line['file']} does not fit the manifest: it needs observations of "
                f"{shape}"
            )
        return found


def load(folder: str | os.PathLike[str]) -> Dataset:
    """A data set that `write` has written.

    Parameters
    ----------
    folder : path-like
        Where it is.

    Returns
    -------
    Dataset
        Nothing but its manifest has been read.

    Raises
    ------
    ValueError
        Where there is none, or it is of another format.
    """
    path = Path(folder)
    return Dataset(path, read_manifest(path))
