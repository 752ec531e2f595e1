"""What shows a scene soonest, by what works."""

from __future__ import annotations

import pytest

from scenec.backends.run.auto import quickest
from scenec.schemas.errors import BackendError


@pytest.mark.parametrize(
    ("working", "denoising", "chosen"),
    [
        ({"pyrender", "mitsuba", "cycles"}, {"mitsuba", "cycles"}, ("pyrender", 8, False)),
        ({"pyrender"}, set(), ("pyrender", 8, False)),
        ({"mitsuba", "cycles"}, {"mitsuba", "cycles"}, ("mitsuba", 4, True)),
        ({"mitsuba"}, set(), ("mitsuba", 16, False)),
        ({"cycles"}, {"cycles"}, ("cycles", 4, True)),
    ],
)
def test_the_rasterizer_goes_first_then_few_samples_denoised(working, denoising, chosen):
    quick = quickest(lambda name, denoise: name in (denoising if denoise else working))
    assert (quick.backend, quick.spp, quick.denoise) == chosen


def test_where_nothing_draws_the_remedy_is_said():
    with pytest.raises(BackendError, match=r"pip install 'scenec\[pyrender\]'"):
        quickest(lambda _name, _denoise: False)
