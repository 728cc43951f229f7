import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap import InputError
from jaxmocap.optim import ArrowVariables
from jaxmocap.optim.packing import blocks_first, blocks_last, bucket, flatten, make_layout, unflatten_last

Y = ArrowVariables(
    {"a": jnp.arange(6.0).reshape(2, 3), "b": jnp.asarray(7.0)},
    {"p": jnp.arange(24.0).reshape(4, 3, 2), "q": jnp.arange(4.0)},
)
FREE = ArrowVariables(
    {"a": np.array([[True, False, False], [False, True, True]]), "b": False},
    {"p": np.array([[True, False], [False, False], [False, True]]), "q": True},
)


def test_flat_numbers_are_the_free_ones_in_order():
    layout = make_layout(Y, FREE)
    assert (layout.shared_size, layout.local_size) == (3, 3)
    flat = flatten(layout, Y)
    np.testing.assert_array_equal(flat.shared, [0, 4, 5])
    np.testing.assert_array_equal(flat.local, [[0, 6, 12, 18], [5, 11, 17, 23], [0, 1, 2, 3]])


def test_there_and_back_with_frozen_numbers_from_the_base():
    layout = make_layout(Y, FREE)
    base = ArrowVariables(jax.tree.map(lambda x: -x, Y.shared), blocks_last(jax.tree.map(lambda x: -x, Y.local)))
    back = unflatten_last(layout, flatten(layout, Y), base)
    np.testing.assert_array_equal(back.shared["a"], [[0, -1, -2], [-3, 4, 5]])
    assert float(back.shared["b"]) == -7.0
    p = blocks_first(back.local)["p"]
    np.testing.assert_array_equal(p[1], [[6, -7], [-8, -9], [-10, 11]])
    np.testing.assert_array_equal(back.local["q"], [0, 1, 2, 3])


def test_layouts_compare_and_hash():
    assert make_layout(Y, FREE) == make_layout(Y, FREE) and hash(make_layout(Y, FREE)) == hash(make_layout(Y, FREE))
    assert make_layout(Y, FREE) != make_layout(Y, None)
    assert make_layout(Y, None).shared_size == 7


@pytest.mark.parametrize(
    "free", [ArrowVariables(True, {"p": True}), ArrowVariables({"a": np.ones(5, bool), "b": True}, True)]
)
def test_flags_that_do_not_fit(free):
    with pytest.raises(InputError, match="free"):
        make_layout(Y, free)


def test_buckets():
    sizes = np.arange(1, 5000)
    padded = np.array([bucket(int(n)) for n in sizes])
    assert np.all(padded >= sizes) and np.all(padded <= 1.25 * sizes)
    np.testing.assert_array_equal(padded[:8], sizes[:8])
    assert len(np.unique(padded)) < 50 and all(bucket(int(n)) == n for n in np.unique(padded))
    finer = np.array([bucket(int(n), 8) for n in sizes])
    assert np.all(finer >= sizes) and np.all(finer <= 1.125 * sizes) and len(np.unique(finer)) < 100
