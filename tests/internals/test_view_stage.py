"""The caption of a scene: numbers of one length, and the film's first picture."""

import importlib.util

import numpy as np
import pytest

from twistax.view import film, stage

pytestmark = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ([30000.0, 28900.4], ["30,000", "28,900"]),
        ([0.0, -0.00863], ["0.00000", "-0.00863"]),
        ([-6.75e-33, 0.25], ["0.000", "0.250"]),
        ([[1.0, 2.0], [0.5, -12.34]], ["1.0, 2.0", "0.5, -12.3"]),
        ([1e-30, 2e-30], ["1e-30", "2e-30"]),
        ([np.nan, 1.0], ["nan", "1"]),
    ],
)
def test_a_caption_keeps_its_digits_over_the_motion(values: list, texts: list[str]) -> None:
    array = np.array(values)
    assert [stage._listed(row, stage._decimals(array)) for row in array] == texts


def test_a_film_begins_when_the_browser_shows_what_stays() -> None:
    """Camera and text come some pictures after the browser has connected."""

    class Client:
        pictures = iter([0, 1, 2, 2, 3])

        def get_render(self, height: int, width: int, **_: object) -> np.ndarray:
            return np.full((height, width, 3), next(self.pictures))

    client = Client()
    film._settle(client, (4, 2))
    assert next(client.pictures) == 3
