"""The shared thresholds mean what they say."""

import numpy as np

from diffshade.core import thresholds as of


def test_what_is_rounding_lies_between_the_precision_and_what_is_seen():
    assert np.finfo(float).eps < of.TINY < of.ROUNDING < np.finfo(float).eps ** 0.5
    assert np.finfo(np.float32).eps < of.SINGLE < 10.0 * np.finfo(np.float32).eps
    assert of.SINGLE < of.NEGLIGIBLE < of.GREY_LEVEL == 1.0 / np.iinfo(np.uint8).max


def test_shares_and_ratios_rise_with_their_words():
    assert of.NEGLIGIBLE < of.SLIGHT < of.MINOR < of.SMALL < of.MOST < 1.0 < of.CLEARLY < of.FAR_MORE
    assert of.INTERVALS[0] < of.INTERVALS[1] == 1.0 - of.MINOR
