import random

from cyclekit_adapters.tracking.linking import FORGET_S, link


def test_two_people_who_walk_keep_their_tracks_whatever_the_order_in_the_file():
    chance = random.Random(1)
    frames = []
    for i in range(40):
        two = [(0.05 * i, 0.0, 0.0), (0.05 * i, 0.0, 2.0)]
        frames.append(two if chance.random() < 0.5 else two[::-1])
    names = link([0.1 * i for i in range(40)], frames)
    tracks = {
        (name, place[2])
        for frame, said in zip(frames, names, strict=True)
        for place, name in zip(frame, said, strict=True)
    }
    assert len(tracks) == 2


def test_nobody_is_two_bodies_of_one_frame():
    names = link([0.0, 0.1], [[(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)], [(0.05, 0.0, 0.0), (0.06, 0.0, 0.0)]])
    assert all(len(set(frame)) == 2 for frame in names)


def test_a_body_farther_away_than_anyone_walks_is_somebody_else():
    names = link([0.0, 0.1], [[(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)], [(0.1, 0.0, 0.0), (5.0, 0.0, 0.0)]])
    assert names == [["1", "2"], ["1", "3"]]


def test_a_track_not_seen_for_long_is_over():
    places = [[(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)], [(9.0, 0.0, 0.0), (0.0, 0.0, 0.0)]]
    assert link([0.0, 0.6, 0.6 + 0.9 * FORGET_S], places)[2] == ["3", "1"]


def test_where_no_frame_has_two_bodies_there_is_one_person():
    assert link([0.0, 60.0], [[(0.0, 0.0, 0.0)], [(9.0, 0.0, 0.0)]]) == [["1"], ["1"]]
    assert link([], []) == []
