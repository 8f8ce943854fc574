"""The tree of controls: what the page is told of it, and what can be pressed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.pages import PageOf

from trolley_viz.controls.controls import BadValue, Control, Controls, NotThere
from trolley_viz.controls.messages import Command

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def told(controls: Controls) -> dict[str, object]:
    """What the page is told now: the values by their labels."""
    changes = controls.take_changes()
    return {} if changes is None else {one.label: one.value for one in changes.looks.values()}


def test_a_change_is_told_once_and_only_the_newest() -> None:
    controls = Controls()
    name = controls.add_text("Name", "")
    told(controls)
    for value in ("a", "b"):
        name.value = value
    assert told(controls) == {"Name": "b"}
    name.value = "b"
    assert controls.take_changes() is None


def test_what_is_typed_is_taken_and_not_told_back() -> None:
    controls, typed = Controls(), list[str]()
    name = controls.add_text("Name", "")
    name.on_change(typed.append)
    told(controls)
    controls.handle(name.id, "kitchen")
    assert (name.value, typed, controls.take_changes()) == ("kitchen", ["kitchen"], None)


def test_what_the_service_sets_itself_is_nobodys_wish() -> None:
    typed = list[str]()
    name = Controls().add_text("Name", "")
    name.on_change(typed.append)
    name.value = "kitchen"
    assert typed == []


def test_a_number_out_of_range_is_clamped_and_told_back() -> None:
    controls, taken = Controls(), list[float]()
    tries = controls.add_number("Tries", 1, min=1, max=1000)
    tries.on_change(taken.append)
    told(controls)
    controls.handle(tries.id, 5)
    assert controls.take_changes() is None
    controls.handle(tries.id, -3)
    assert told(controls) == {"Tries": 1.0}
    controls.handle(tries.id, 1e300)
    assert told(controls) == {"Tries": 1000.0}
    assert taken == [5.0, 1.0, 1000.0]


def test_a_new_page_is_told_everything() -> None:
    controls = Controls()
    controls.add_text("Name", "a")
    controls.add_command("Undo", "u", lambda: None)
    controls.take_changes()
    controls.forget_sent()
    changes = controls.take_changes()
    assert changes is not None
    assert len(changes.looks) == len(controls.all)
    assert changes.commands == controls.commands


def test_what_is_not_there_cannot_be_pressed() -> None:
    controls, pressed = Controls(), list[str]()
    with controls.add_folder("Outer") as outer, controls.add_folder("Inner") as inner:
        button = controls.add_button("Go")
    button.on_press(lambda: pressed.append("go"))
    for control in (button, inner, outer):
        control.visible = False
        with pytest.raises(NotThere):
            controls.handle(button.id, None)
        control.visible = True
    button.disabled = True
    with pytest.raises(NotThere):
        PageOf(controls).press("Go")
    button.disabled = False
    PageOf(controls).press("Go")
    outer.remove()
    with pytest.raises(NotThere):
        controls.handle(button.id, None)
    assert pressed == ["go"]


def test_with_a_folder_goes_what_is_in_it() -> None:
    controls = Controls()
    with controls.add_folder("Outer") as outer:
        with controls.add_folder("Inner") as inner:
            button = controls.add_button("Go")
        key = controls.add_command("Undo", "u", lambda: None)
    stays = controls.add_button("Stay")
    controls.take_changes()
    button.label = "Gone"
    outer.remove()
    changes = controls.take_changes()
    assert changes is not None
    assert (changes.looks, changes.gone) == ({}, [outer.id, inner.id, button.id, key.id])
    assert changes.commands == []
    assert [*controls.all] == [stays.id]
    button.label = "Still gone"  # a panel may hold it for a while
    assert controls.take_changes() is None


def test_a_list_keeps_what_was_chosen_while_it_is_offered() -> None:
    controls = Controls()
    places = controls.add_list("Place", ("a", "b"), value="b")
    places.options = ("a", "b", "c")
    assert places.value == "b"
    places.options = ("a", "c")
    assert places.value == "a"
    places.options = ()
    assert places.value == ""


def test_a_folder_stays_as_its_person_left_it() -> None:
    controls, left = Controls(), list[bool]()
    folder = controls.add_folder("Keys")
    folder.on_fold(left.append)
    controls.handle(folder.id, True)
    folder.label = "All keys"
    assert (folder.look.is_open, left) == (True, [True])


def test_commands_are_told_where_they_change_and_work_unseen() -> None:
    controls, pressed = Controls(), list[str]()
    undo = controls.add_command("Undo", "u", lambda: pressed.append("undo"))
    changes = controls.take_changes()
    assert changes is not None
    assert changes.commands == [Command(id=undo.id, title="Undo", key="u")]
    controls.add_button("Go")
    changes = controls.take_changes()
    assert changes is not None
    assert changes.commands is None
    PageOf(controls).press_key("u")
    undo.remove()
    with pytest.raises(NotThere):
        controls.handle(undo.id, None)
    assert (controls.commands, pressed) == ([], ["undo"])


def test_what_nobody_looks_at_is_told_once_it_is_looked_at() -> None:
    controls = Controls()
    tabs = controls.add_tabs()
    with tabs.add_tab("Go", "x") as go:
        word = controls.add_html("")
    with tabs.add_tab("More", "x") as more:
        age = controls.add_html("")
        with controls.add_folder("Keys") as keys:
            inner = controls.add_html("")
        with controls.add_folder(visible=False) as hidden:
            deep = controls.add_html("")

    def told() -> set[int]:
        changes = controls.take_changes()
        return set() if changes is None else set(changes.looks)

    def change() -> None:
        for one in (word, age, inner, deep):
            one.content += "x"

    assert {word.id, age.id, inner.id, deep.id} <= told()  # all there is, once
    change()
    assert told() == {word.id}
    change()
    controls.handle(tabs.id, float(more.id))  # as JSON numbers come
    assert told() == {age.id}
    controls.handle(keys.id, True)
    assert told() == {inner.id}
    hidden.visible = True
    assert told() == {hidden.id, deep.id}
    controls.handle(tabs.id, float(go.id))
    assert told() == {word.id}
    change()
    controls.forget_sent()
    assert {word.id, age.id, inner.id, deep.id} <= told()
    age.visible = False
    assert told() == set()
    age.remove()
    assert controls.take_changes() is not None


def one_of_each() -> tuple[Controls, list[Control]]:
    controls = Controls()
    tabs = controls.add_tabs()
    return controls, [
        tabs,
        tabs.add_tab("Go", "x"),
        controls.add_tiles(),
        controls.add_folder("Keys"),
        controls.add_html(""),
        controls.add_button("Go"),
        controls.add_choice("Order", ("a", "b")),
        controls.add_text("Name", ""),
        controls.add_number("Tries", 1, min=1, max=3),
        controls.add_number("From", 0.0),
        controls.add_slider("Turn", 0.0, min=-180.0, max=180.0, step=0.5),
        controls.add_check("On", False),
        controls.add_list("Place", ("a", "b")),
    ]


@given(JSON | st.sampled_from(["a", "b", 10**400, -(10**400)]))
def test_no_value_from_a_page_does_harm(value: object) -> None:
    controls, each = one_of_each()
    for control in each:
        look = control.look
        try:
            controls.handle(control.id, value)  # type: ignore[arg-type]
        except BadValue:
            assert control.look == look
        else:
            assert type(control.look.value) is type(look.value) or look.kind in ("number", "slider")


@pytest.mark.parametrize(
    ("label", "value"),
    [
        ("Order", "c"),
        ("Name", 3),
        ("Name", "x" * 100_000),
        ("Tries", True),
        ("Tries", float("nan")),
        ("Tries", float("inf")),
        ("Tries", "2"),
        ("On", 1),
        ("Place", "c"),
        ("Keys", None),
        ("Keys", 1.0),
    ],
)
def test_what_a_control_cannot_hold_is_refused(label: str, value: object) -> None:
    controls, each = one_of_each()
    control = next(one for one in each if one.label == label)
    with pytest.raises(BadValue):
        controls.handle(control.id, value)  # type: ignore[arg-type]
