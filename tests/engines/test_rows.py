"""Rows of particles whose ids LIGGGHTS gives to others when they are gone."""

from __future__ import annotations

import numpy as np

from kncal.engines.liggghts.rows import Rows, inverse


def test_each_new_id_gets_the_next_row_and_keeps_it() -> None:
    rows = Rows(6)
    assert rows(np.array([2, 0, 1])).tolist() == [2, 0, 1]
    assert rows(np.array([0, 1])).tolist() == [0, 1]  # id 2 is gone
    assert rows(np.array([2, 0, 1])).tolist() == [3, 0, 1]  # and is another particle's
    again = Rows(6)
    again.load(*rows.state)
    for book in (rows, again):
        assert book(np.array([1, 3, 2])).tolist() == [1, 4, 3]
        assert book.come == 5 and not book.full
    assert rows(np.array([1, 3, 2, 0])).tolist() == [1, 4, 3, 5]


def test_more_particles_than_rows_are_told_not_stored() -> None:
    rows = Rows(2)
    rows(np.array([0, 1, 2]))
    assert rows.full


def test_all_of_them_in_any_order() -> None:
    rows = Rows(3)
    ids = np.array([1, 2, 0])
    assert rows(ids).tolist() == rows(ids).tolist() == [1, 2, 0]
    assert inverse(ids, 4).tolist() == [2, 0, 1, -1]
