"""Grids of lanes in blocks: every lane once, and in the order in which values follow each other."""

import numpy as np
import pytest

from jaxshroud.io.zarr_arrays import block_chains, block_shape


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize(("shape", "lanes"), [((7,), 3), ((5, 4), 8), ((2, 5, 4), 6), ((1, 9), 64)])
def test_blocks_have_every_lane_once_and_follow_each_other(shape, lanes, backward):
    count = np.zeros(shape, int)
    for chain in block_chains(shape, block_shape(shape, lanes), backward=backward):
        firsts = [block.at[0].start for block in chain]
        assert firsts == sorted(firsts, reverse=backward)
        assert all(block.at[1:] == chain[0].at[1:] for block in chain)
        for block in chain:
            assert block.lanes <= max(lanes, 1)
            count[block.at] += 1
    assert (count == 1).all()
