"""The network of a detector: alike for all satellites, causal, and the same epoch by epoch."""

from __future__ import annotations

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")

from agents.detector_network import DetectorNetwork, statistic_of

SLOTS, RECEIVER = 6, ("chi_square_ratio", "classic_aime")
WORDS = ("range_innovation", "rate_innovation", "visible")
SIGHTS = ("sight_north", "sight_east", "sight_down")


def names(*words: str) -> tuple[str, ...]:
    return (*(f"{word}_slot{k:02d}" for word in words for k in range(SLOTS)), *RECEIVER)


def network(*words: str) -> DetectorNetwork:
    torch.manual_seed(3)
    made = DetectorNetwork(names(*words), 0.5, width=8, projections=3)
    for each in made.parameters():
        torch.nn.init.normal_(each, std=0.5)
    return made.eval()


def episodes(words: tuple[str, ...], batch: int = 3, epochs: int = 25) -> torch.Tensor:
    rng = np.random.default_rng(5)
    seen = rng.normal(size=(batch, epochs, len(names(*words)))).astype(np.float32)
    shown = rng.random((batch, epochs, SLOTS)) < 0.8
    for k, word in enumerate(words):
        part = slice(k * SLOTS, (k + 1) * SLOTS)
        seen[:, :, part] = shown if word == "visible" else seen[:, :, part] * shown
    return torch.from_numpy(seen)


@pytest.mark.parametrize("words", [(*WORDS, *SIGHTS), WORDS], ids=["sighted", "without sights"])
def test_slots_may_be_exchanged_and_nothing_else(words: tuple[str, ...]) -> None:
    judge, seen = network(*words), episodes(words)
    order = np.random.default_rng(1).permutation(SLOTS)
    moved = np.concatenate([k * SLOTS + order for k in range(len(words))])
    moved = np.concatenate([moved, np.arange(len(moved), seen.shape[-1])])
    with torch.no_grad():
        before, after = judge.log_odds(seen), judge.log_odds(seen[:, :, moved])
        alone = seen.clone()
        alone[:, :, :SLOTS] = seen[:, :, order]  # one kind of element alone
        mixed = judge.log_odds(alone)
    torch.testing.assert_close(before, after, atol=1e-4, rtol=1e-4)
    assert (before - mixed).abs().max() > 1e-2


def test_it_knows_nothing_of_the_future_and_remembers_the_past() -> None:
    words = (*WORDS, *SIGHTS)
    judge, seen = network(*words), episodes(words)
    other = seen.clone()
    other[:, 10] += 0.5
    with torch.no_grad():
        before, after = judge.log_odds(seen), judge.log_odds(other)
    assert (before[:, :10] == after[:, :10]).all()
    assert (before[:, 12:] != after[:, 12:]).all(dim=0).any()


def test_a_satellite_that_is_not_in_view_is_not_looked_at() -> None:
    words = (*WORDS, *SIGHTS)
    judge, seen = network(*words), episodes(words)
    judge.slot_mean += 0.3
    hidden = seen[:, :, 2 * SLOTS : 3 * SLOTS] < 0.5
    other = seen.clone()
    for k in (0, 1):
        other[:, :, k * SLOTS : (k + 1) * SLOTS][hidden] = 7.0
    with torch.no_grad():
        torch.testing.assert_close(judge.log_odds(seen), judge.log_odds(other))


def test_the_clock_of_the_receiver_moves_no_vector() -> None:
    words = (*WORDS, *SIGHTS)
    judge, seen = network(*words), episodes(words)
    shown = seen[..., 2 * SLOTS : 3 * SLOTS]
    other = seen.clone()
    other[..., :SLOTS] += 3.0 * shown  # alike on all ranges
    with torch.no_grad():
        torch.testing.assert_close(
            judge.encode(seen)[1], judge.encode(other)[1], atol=1e-5, rtol=1e-4
        )


@pytest.mark.parametrize("words", [(*WORDS, *SIGHTS), WORDS], ids=["sighted", "without sights"])
def test_epoch_by_epoch_it_says_what_it_says_of_an_episode(words: tuple[str, ...]) -> None:
    judge, seen = network(*words), episodes(words)
    state = [torch.zeros(len(seen), size) for size in judge.state.values()]
    found = []
    with torch.no_grad():
        wanted = statistic_of(judge.log_odds(seen).numpy())
        for t in range(seen.shape[1]):
            action, *state = judge(seen[:, t], *state)
            found.append(0.5 * (1.0 + action[:, 0].numpy()))
    np.testing.assert_allclose(np.array(found).T, wanted, atol=1e-5)


def test_centre_and_scale_are_those_of_satellites_in_view() -> None:
    judge, seen = network(*WORDS), episodes(WORDS).reshape(-1, len(names(*WORDS)))
    shown = seen[:, 2 * SLOTS : 3 * SLOTS] > 0.5
    seen[:, :SLOTS] = torch.where(shown, 4.0 + 2.0 * seen[:, :SLOTS], 0.0)
    judge.normalize_by(seen.numpy())
    assert judge.slot_mean[0].item() == pytest.approx(4.0, abs=0.3)
    assert judge.slot_scale[0].item() == pytest.approx(2.0, rel=0.2)
    with torch.no_grad():
        assert judge.encode(seen)[0][:, :2].mean(dim=0).abs().max() < 1e-4  # of the receiver


def test_the_tail_of_the_statistic_keeps_its_resolution() -> None:
    odds = np.arange(0.0, 40.0, 0.01, dtype=np.float32)
    exact = torch.nn.functional.softsign(torch.from_numpy(odds)).numpy()
    assert (np.diff(exact) > 0.0).all()
    sigmoid = torch.sigmoid(torch.from_numpy(odds)).numpy()
    assert not (np.diff(sigmoid) > 0.0).all()  # which is why


def test_observations_without_satellites_in_view_are_refused() -> None:
    with pytest.raises(ValueError, match="must have visible_slotNN"):
        DetectorNetwork(names("range_innovation"), 0.5)
