"""What a page is told, in its language: all but the names that people gave."""

import dataclasses
from collections.abc import Sequence

from msgspec import structs

from trolley_viz.controls.messages import Command, ControlChanges, Look
from trolley_viz.languages.translator import Translator
from trolley_viz.overlays.cards import Card
from trolley_viz.overlays.pages import OverlayUpdate
from trolley_viz.robots.stop_presses import StopLine
from trolley_viz.server.messages import PageState, Told
from trolley_viz.words.sentences import StatusLine


def in_language(told: Told, words: Translator | None) -> Told:
    """Translate what a page is told; without `words` it stays in English."""
    if words is None:
        return told
    say = words.text
    answer, notice, state, pad = told.answer, told.notice, told.state, told.pad
    return structs.replace(
        told,
        answer=answer and structs.replace(answer, text=say(answer.text)),
        notice=notice and structs.replace(notice, title=say(notice.title), text=say(notice.text)),
        state=state and _state(state, words),
        controls=told.controls and _controls(told.controls, words),
        pad=pad and structs.replace(pad, text=say(pad.text)),
        overlays=told.overlays and _overlays(told.overlays, words),
    )


def _state(state: PageState, words: Translator) -> PageState:
    stop = state.stop
    return structs.replace(
        state,
        sentence=_line(state.sentence, words),
        lines=[_line(line, words) for line in state.lines],
        stop=stop and StopLine(words.text(stop.text), stop.is_alarm),
        hint=words.text(state.hint),
        stopped_by=words.text(state.stopped_by),
    )


def _line(line: StatusLine, words: Translator) -> StatusLine:
    headline, detail = words.text(line.headline), words.text(line.detail)
    return dataclasses.replace(line, headline=headline, detail=detail)


def _controls(changes: ControlChanges, words: Translator) -> ControlChanges:
    looks = {id_: _look(look, words) for id_, look in changes.looks.items()}
    commands = changes.commands
    return structs.replace(
        changes,
        looks=looks,
        commands=None if commands is None else [_command(one, words) for one in commands],
    )


def _look(look: Look, words: Translator) -> Look:
    return structs.replace(
        look,
        label=look.label if look.is_name else words.text(look.label),
        hint=words.text(look.hint),
        shown=_shown(look.options, look.words, words),
        content=words.markup(look.content),
    )


def _shown(options: Sequence[str], own: Sequence[str] | None, words: Translator) -> tuple[str, ...]:
    """What stands for the options of a list, of which only `own` are no names; None: all."""
    return tuple(words.text(one) if own is None or one in own else one for one in options)


def _command(command: Command, words: Translator) -> Command:
    return structs.replace(command, title=words.text(command.title))


def _overlays(update: OverlayUpdate, words: Translator) -> OverlayUpdate:
    cards = {name: _card(card, words) for name, card in update.cards.items()}
    return structs.replace(update, cards=cards, note=words.text(update.note))


def _card(card: Card, words: Translator) -> Card:
    return structs.replace(card, head=words.card(card.head), body=words.card(card.body))
