"""Transforms into cosines and sines have the bits of SciPy's, whichever way they are reached."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from scenec.compiler.arithmetic import cosines


@pytest.mark.parametrize("compiled", [True, False])
def test_transforms_have_the_bits_of_scipys(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if compiled:
        assert cosines._compiled() is not None
    else:
        monkeypatch.setattr(cosines, "_compiled", lambda: None)
    field = np.random.default_rng(1).standard_normal((38, 27))
    for axis in (0, 1):
        for ours, theirs, kind in (
            (cosines.dct, scipy.fft.dct, 2),
            (cosines.idct, scipy.fft.idct, 2),
            (cosines.dst, scipy.fft.dst, 1),
            (cosines.idst, scipy.fft.idst, 1),
        ):
            assert np.array_equal(ours(field, axis), theirs(field, type=kind, axis=axis))
    expected = scipy.fft.dctn(field, type=2)
    assert np.array_equal(cosines.dct(field), expected)
    assert np.array_equal(cosines.idct(expected), scipy.fft.idctn(expected, type=2))
    assert np.array_equal(cosines.dct(field, over=True), expected)
