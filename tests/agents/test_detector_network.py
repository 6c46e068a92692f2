"""Networks of a detector: alike for all satellites or headings, causal, the same by epochs."""

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")

from agents.detector_network import (
    SHIFTS,
    WINDOWS_S,
    DetectorNetwork,
    WindowNetwork,
    compute_statistic,
)

SLOTS, RECEIVER = 6, ("chi_square_ratio", "classic_aime")
WORDS = ("range_innovation", "rate_innovation", "visible")
SIGHTED = (*WORDS, "sight_north", "sight_east", "sight_down")
RANGES, RATES, SHOWN = (slice(k * SLOTS, (k + 1) * SLOTS) for k in range(3))
both = pytest.mark.parametrize("words", [SIGHTED, WORDS], ids=["sighted", "without sights"])


def made(words):
    torch.manual_seed(3)
    names = (*(f"{word}_slot{k:02d}" for word in words for k in range(SLOTS)), *RECEIVER)
    judge = DetectorNetwork(names, 0.5, width=8, projections=3)
    for each in judge.parameters():
        torch.nn.init.normal_(each, std=0.5)
    rng = np.random.default_rng(5)
    seen = rng.normal(size=(3, 25, len(names))).astype(np.float32)
    shown = rng.random((3, 25, SLOTS)) < 0.8
    seen[..., : -len(RECEIVER)] *= np.tile(shown, len(words))
    seen[:, :, SHOWN] = shown
    return judge.eval(), torch.from_numpy(seen)


@pytest.fixture(autouse=True)
def no_grad():
    with torch.no_grad():
        yield


@both
def test_slots_may_be_exchanged_alone_and_epoch_by_epoch_it_says_the_same_of_an_episode(words):
    judge, seen = made(words)
    order = np.random.default_rng(1).permutation(SLOTS)
    moved = np.arange(seen.shape[-1])
    moved[: -len(RECEIVER)] = np.concatenate([k * SLOTS + order for k in range(len(words))])
    before, after = judge.log_odds(seen), judge.log_odds(seen[:, :, moved])
    torch.testing.assert_close(before, after, atol=1e-4, rtol=1e-4)
    alone = seen.clone()
    alone[:, :, :SLOTS] = seen[:, :, order]  # one kind of element alone
    assert (before - judge.log_odds(alone)).abs().max() > 1e-2
    judge, seen = made(words)
    state = [torch.zeros(len(seen), size) for size in judge.state.values()]
    found = []
    for t in range(seen.shape[1]):
        action, *state = judge(seen[:, t], *state)
        found.append(0.5 * (1.0 + action[:, 0].numpy()))
    wanted = compute_statistic(judge.log_odds(seen).numpy())
    np.testing.assert_allclose(np.array(found).T, wanted, atol=1e-5)


def made_of_windows(interval_s=4.0, epochs=100):
    torch.manual_seed(3)
    judge = WindowNetwork(("classic_aime", *SHIFTS), interval_s, width=8, projections=3)
    for each in judge.parameters():
        torch.nn.init.normal_(each, std=0.3)
    seen = np.random.default_rng(5).normal(size=(3, epochs, 5)).astype(np.float32)
    return judge.eval(), torch.from_numpy(seen)


def test_windows_say_the_same_epoch_by_epoch_and_whatever_the_heading():
    judge, seen = made_of_windows()
    past, found = torch.zeros(len(seen), *judge.state.values()), []
    for t in range(seen.shape[1]):
        action, past = judge(seen[:, t], past)
        found.append(0.5 * (1.0 + action[:, 0].numpy()))
    wanted = judge.log_odds(seen)
    np.testing.assert_allclose(np.array(found).T, compute_statistic(wanted.numpy()), atol=1e-5)
    turn = np.deg2rad(35.0)
    turned = seen.clone()
    for k in (1, 3):
        turned[..., k] = np.cos(turn) * seen[..., k] - np.sin(turn) * seen[..., k + 1]
        turned[..., k + 1] = np.sin(turn) * seen[..., k] + np.cos(turn) * seen[..., k + 1]
    torch.testing.assert_close(judge.log_odds(turned), wanted, atol=1e-4, rtol=1e-4)
    turned[..., 3:] = seen[..., 3:]  # one of the two alone
    assert (judge.log_odds(turned) - wanted).abs().max() > 1e-2
    assert (judge.log_odds(seen[:, :, [1, 0, 2, 3, 4]]) - wanted).abs().max() > 1e-2


def test_windows_forget_what_is_older_than_the_longest_and_see_no_future():
    judge, seen = made_of_windows()
    longest = round(max(WINDOWS_S) / 4.0)
    other = seen.clone()
    other[:, 10] += 3.0
    apart = (judge.log_odds(other) - judge.log_odds(seen)).abs().max(dim=0).values.numpy()
    assert (apart[:10] == 0.0).all()
    assert (apart[10 : 10 + longest] > 1e-4).all()
    assert apart[10 + longest :].max() < 1e-5
    # sums of few epochs have the variance of those of many
    sums = []
    judge.judge, held = lambda _, windows: sums.append(windows) or windows, judge.judge
    judge.log_odds(torch.ones(1, 60, 5))
    judge.judge = held
    counts = sums[0][0, :, -1]
    assert counts[:, -1].tolist() == [*map(float, np.minimum(np.arange(60) + 1, longest))]
    assert (counts[:, 0] == 1.0).all()
    with pytest.raises(ValueError, match=r"must have shift_velocity_north, .* 'filter-shift'"):
        WindowNetwork(("classic_aime",), 0.5)
    with pytest.raises(ValueError, match="observes no slots, got visible_slot00"):
        WindowNetwork((*SHIFTS, "visible_slot00"), 0.5)


def test_neither_the_future_nor_hidden_satellites_nor_the_clock_move_anything():
    judge, seen = made(SIGHTED)
    other = seen.clone()
    other[:, 10] += 0.5
    before, after = judge.log_odds(seen), judge.log_odds(other)
    assert (before[:, :10] == after[:, :10]).all()
    assert (before[:, 12:] != after[:, 12:]).all(dim=0).any()
    judge, seen = made(SIGHTED)
    other = seen.clone()
    other[..., RANGES] += 3.0 * seen[..., SHOWN]  # alike on all ranges
    vectors = [judge.encode(each)[1] for each in (seen, other)]
    torch.testing.assert_close(*vectors, atol=1e-5, rtol=1e-4)
    judge.slot_mean += 0.3
    other = seen.clone()
    for part in (RANGES, RATES):
        other[..., part][seen[..., SHOWN] < 0.5] = 7.0
    torch.testing.assert_close(judge.log_odds(seen), judge.log_odds(other))


def test_centre_and_scale_are_those_of_satellites_in_view_and_the_tail_keeps_its_resolution():
    judge, seen = made(WORDS)
    seen = seen.reshape(-1, seen.shape[-1])
    seen[:, RANGES] = torch.where(seen[:, SHOWN] > 0.5, 4.0 + 2.0 * seen[:, RANGES], 0.0)
    judge.normalize_by(seen.numpy())
    assert judge.slot_mean[0].item() == pytest.approx(4.0, abs=0.3)
    assert judge.slot_scale[0].item() == pytest.approx(2.0, rel=0.2)
    assert judge.encode(seen)[0][:, :2].mean(dim=0).abs().max() < 1e-4  # of the receiver
    with pytest.raises(ValueError, match="must have visible_slotNN"):
        DetectorNetwork(("range_innovation_slot00",), 0.5)
    odds = np.arange(0.0, 40.0, 0.01, dtype=np.float32)
    single = compute_statistic(odds).astype(np.float32)  # as it comes from a file
    assert (np.diff(single) > 0.0).all()  # which those of a sigmoid are not
