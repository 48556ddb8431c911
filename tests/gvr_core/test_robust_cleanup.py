"""What no view has seen follows its neighbours; strays are dropped; nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from small_scene import box

from gvr_core.robust.cleanup import follow_neighbours

K = 16


def shell_and_core() -> tuple[np.ndarray, np.ndarray]:
    """A cube of 8 x 8 x 8 points and which of them are its faces."""
    points = box((0, 0, 0), 1.0, 8)
    return points, (np.abs(points) > 0.499).any(axis=1)


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, what belongs to the cube, and what views see: its faces, and a floor below it."""
    cube, shell = shell_and_core()
    ticks = np.linspace(-3, 3, 40)
    floor = np.stack(np.meshgrid(ticks, ticks, [-0.9]), axis=-1).reshape(-1, 3)
    means = np.concatenate([cube, floor]).astype(np.float32)
    member = np.arange(len(means)) < len(cube)
    seen = np.concatenate([shell, np.ones(len(floor), np.bool_)])
    return means, member, seen


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("guess", [False, True])
def test_the_unseen_inside_follows_the_seen_faces(scale: float, guess: bool) -> None:
    means, member, seen = scene()
    flags = np.where(seen, member, guess)
    found = follow_neighbours(means * np.float32(scale), flags, seen, K)
    np.testing.assert_array_equal(found, member)


def test_the_unseen_inside_of_something_else_is_not_taken() -> None:
    """Its neighbours are seen, and are not the object, whatever was guessed of it."""
    means, member, seen = scene()
    cube = means[member]
    other = cube * np.float32(0.4) + np.float32([0.0, 0.0, 2.0])
    handle = cube * np.float32([0.05, 0.05, 3.0]) + np.float32([0.45, 0.45, 1.5])
    shell = shell_and_core()[1]
    everything = np.concatenate([means, other, handle])
    flags = np.concatenate([member, ~shell, np.ones(len(handle), np.bool_)])
    all_seen = np.concatenate([seen, shell, np.ones(len(handle), np.bool_)])
    found = follow_neighbours(everything, flags, all_seen, K)
    others = slice(len(means), len(means) + len(other))
    assert flags[others].any() and not found[others].any()
    assert found[: len(means)][member].all()


@pytest.mark.parametrize(("members", "taken"), [(7, False), (8, False), (9, True)])
def test_more_than_half_of_the_neighbours_decide(members: int, taken: bool) -> None:
    """One unseen point amid sixteen seen ones, all equally far from it."""
    yaw = 2 * np.pi * np.arange(16) / 16
    ring = np.stack([np.cos(yaw), np.sin(yaw), np.zeros(16)], axis=1)
    far = ring * 0.2 + np.array([1.4, 0.0, 0.0])
    means = np.concatenate([ring, [[0, 0, 0]], far, [[-1.6, -1.6, 0]]]).astype(np.float32)
    flags = np.arange(34) < members
    flags[17:] = True
    seen = np.arange(34) != 16
    assert follow_neighbours(means, flags, seen, K)[16] == taken


def test_a_stray_is_dropped_and_a_rim_is_not() -> None:
    means, member, seen = scene()
    stray = int(np.argmax(means[:, 0] + means[:, 1]))  # a corner of the floor
    flags = member & seen
    flags[stray] = True
    found = follow_neighbours(means, flags, seen, K)
    assert not found[stray]
    np.testing.assert_array_equal(found & seen, member & seen)


def test_nothing_outside_of_the_targets_box_is_flagged() -> None:
    means, member, seen = scene()
    flags = member & seen
    low, high = means[member].min(axis=0) - 0.1, means[member].max(axis=0) + 0.1
    far = ((means < low) | (means > high)).any(axis=1)
    assert far.sum() > 1000
    # half of what is far away is hidden from the views as well
    hidden = seen.copy()
    hidden[np.flatnonzero(far)[::2]] = False
    found = follow_neighbours(means, flags, hidden, K)
    assert not found[far].any()
    np.testing.assert_array_equal(found, member)


def test_an_unseen_guess_far_from_all_that_was_voted_for_is_dropped() -> None:
    means, member, seen = scene()
    flags, hidden = member & seen, seen.copy()
    far = int(np.argmin(means[:, 0] + means[:, 1]))
    flags[far], hidden[far] = True, False
    assert not follow_neighbours(means, flags, hidden, K)[far]


def test_too_few_votes_change_nothing() -> None:
    means, member, seen = scene()
    rng = np.random.default_rng(0)
    flags = np.zeros(len(means), np.bool_)
    flags[np.flatnonzero(member & seen)[: K - 1]] = True
    flags[rng.choice(np.flatnonzero(~seen), 20)] = True
    np.testing.assert_array_equal(follow_neighbours(means, flags, seen, K), flags)
    none = np.zeros(len(means), np.bool_)
    np.testing.assert_array_equal(follow_neighbours(means, none, seen, K), none)
    np.testing.assert_array_equal(follow_neighbours(means, flags, none, K), flags)


def test_a_single_neighbour_is_enough_to_ask() -> None:
    means, member, seen = scene()
    found = follow_neighbours(means, member & seen, seen, 1)
    np.testing.assert_array_equal(found, member)


def test_the_arguments_stay_as_they_are() -> None:
    means, member, seen = scene()
    flags = member & seen
    before = flags.copy(), seen.copy()
    follow_neighbours(means, flags, seen, K)
    np.testing.assert_array_equal(flags, before[0])
    np.testing.assert_array_equal(seen, before[1])
