"""Compiled loops of the game."""

from __future__ import annotations

from .._jit import njit


@njit
def displace(position_e, true_position_e, epochs, target_e, origin, displacement):
    """Displacements along the target direction.

    Parameters
    ----------
    position_e, true_position_e : ndarray
        (B, 3) estimated, and (K, 3) true, ECEF [m].
    epochs : ndarray
        (B,) the epoch that each receiver is at.
    target_e : ndarray
        (3,) direction in which displacement counts, ECEF.
    origin : ndarray
        (B,) projected error at the onset [m].
    displacement : ndarray
        (B,), written [m].
    """
    for b in range(displacement.shape[0]):
        k = epochs[b]
        total = 0.0
        for i in range(3):
            total += (position_e[b, i] - true_position_e[k, i]) * target_e[i]
        displacement[b] = total - origin[b]


@njit
def score(
    displacement,
    alarms,
    steps,
    hold,
    step_count,
    detected,
    largest,
    gain,
    retraction,
    alarm,
    first,
    finished,
):
    """Keep the books of one step of every receiver.

    Parameters
    ----------
    displacement : ndarray
        (B,) error along the target direction, less that at the onset [m].
    alarms : ndarray
        (B, c) bool, of the verdict.
    steps, hold : int
        Commands of an episode, and epochs of the time to alert.
    step_count : ndarray
        (B,) commands before this one; one more after it.
    detected : ndarray
        (B,) bool, whether there was an alarm before this step.
    largest : ndarray
        (B, steps + 1) largest displacement so far after each step, this one's is written [m].
    gain, retraction : ndarray
        (B,), written [m].
    alarm, first, finished : ndarray
        (B,) bool, written: any alarm, the first alarm, the last command.
    """
    for b in range(step_count.shape[0]):
        # a receiver whose episode is over may be stepped once more before it is reset
        step_count[b] += 1
        j = min(step_count[b], steps)
        before = largest[b, j - 1]
        now = max(before, displacement[b])
        largest[b, j] = now
        any_alarm = False
        for c in range(alarms.shape[1]):
            any_alarm = any_alarm or alarms[b, c]
        alarm[b] = any_alarm
        first[b] = any_alarm and not detected[b]
        quiet = not any_alarm and not detected[b]
        gain[b] = now - before if quiet else 0.0
        retraction[b] = largest[b, max(j - hold - 1, 0)] - before if first[b] else 0.0
        finished[b] = step_count[b] == steps
