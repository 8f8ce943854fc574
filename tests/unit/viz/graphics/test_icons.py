"""Icons: names, colours, and what is drawn for a name that nothing is known of."""

import numpy as np
import pytest

from trolley_viz.graphics.icons import ALIASES, UNKNOWN_ICON, icon_image, icon_names, known_icon


@pytest.mark.parametrize(
    ("name", "icon"),
    [
        ("home", "home"),
        ("robot", "robot"),
        ("fa-robot", "robot"),
        ("fa-home", "home"),
        ("Tools_Kitchen", "tools-kitchen"),
        ("fa-utensils", "tools-kitchen-2"),
        ("", None),
        ("../../etc/passwd", None),
        ("no-such-thing", None),
    ],
)
def test_names_of_the_article_and_of_others_are_understood(name: str, icon: str | None) -> None:
    assert known_icon(name) == icon


def test_every_alias_leads_to_an_icon() -> None:
    assert {alias for alias, icon in ALIASES.items() if icon not in icon_names()} == set()
    assert UNKNOWN_ICON in icon_names()


def test_an_icon_has_the_colour_asked_for_and_is_clear_around_it() -> None:
    picture = icon_image("home", (25, 255, 240), 96)
    assert picture.shape == (96, 96, 4)
    assert picture[0, 0, 3] == 0
    drawn = picture[picture[..., 3] == 255]
    assert len(drawn) > 200
    np.testing.assert_array_equal(np.unique(drawn[:, :3], axis=0), [[25, 255, 240]])


def test_opacity_thins_it() -> None:
    assert icon_image("home", (0, 0, 0), 64, 0.5)[..., 3].max() == pytest.approx(128, abs=2)


def test_an_unknown_name_is_a_question_mark() -> None:
    np.testing.assert_array_equal(
        icon_image("no-such-thing", (9, 9, 9), 64), icon_image(UNKNOWN_ICON, (9, 9, 9), 64)
    )


def test_all_icons_can_be_drawn() -> None:
    for name in sorted(icon_names())[::97]:
        assert icon_image(name, (200, 0, 0), 32)[..., 3].any(), name
