"""A torch module as the bytes of an ONNX file."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import torch

from ..policies.onnx_file import NEXT

TOLERANCE = 1e-5
"""Largest difference of an action between the model and its file."""
TRIED = 1024
"""Random observations on which they are compared."""


@contextmanager
def evaluating(module: torch.nn.Module) -> Iterator[None]:
    """Put a module into its mode of evaluation, and its parts into their own modes again."""
    modes = {part: part.training for part in module.modules()}
    module.train(False)
    try:
        yield
    finally:
        for part, training_mode in modes.items():
            part.training = training_mode


def traced(module: torch.nn.Module, size: int, state: Mapping[str, int] | None = None) -> bytes:
    """ONNX file of a module of (B, o) observations, of any batch; its weights are its own.

    Parameters
    ----------
    module : torch.nn.Module
        In the mode in which it is to be traced.
    size : int
        o.
    state : mapping, optional
        Size of each state by name, which the module takes and returns after the rest.

    Returns
    -------
    bytes
        Without external data, and without a word of this machine.
    """
    states = dict(state or {})
    batch = {0: torch.export.Dim("batch")}
    example = (torch.zeros(2, size), *(torch.zeros(2, length) for length in states.values()))
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)  # it misses torchvision
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch about torch
            program = torch.onnx.export(
                module,
                example,
                dynamo=True,
                verbose=False,
                optimize=False,  # which would fold weights away; onnxruntime optimises by itself
                input_names=["observation", *states],
                output_names=["action", *(f"{NEXT}{name}" for name in states)],
                dynamic_shapes=(batch, tuple(batch for _ in states)) if states else (batch,),
            )
    except (torch.onnx.errors.OnnxExporterError, RuntimeError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(f"torch can't export this network: {first}") from error
    finally:
        log.setLevel(level)
    model: Any = program.model_proto  # as `dynamo` returns it
    graph = model.graph
    # the remarks of the exporter hold paths of this machine
    for part in (model, graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        part.ClearField("doc_string")
        part.ClearField("metadata_props")
    graph.ClearField("value_info")
    return bytes(model.SerializeToString(deterministic=True))


def library_versions() -> dict[str, str]:
    found = {}
    for name in ("torch", "stable-baselines3", "onnx"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
