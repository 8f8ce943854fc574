"""What base has found wrong with robot.toml while the robot drove, and how to set it right."""

from trolley import requests, topics
from trolley.messages import Proposal
from trolley.messages.request_params import WhichProposal
from trolley_viz.controls.controls import Controls
from trolley_viz.controls.markup import lead, note, row
from trolley_viz.features.driving.robot_actions import RobotActions
from trolley_viz.robots.view import View
from trolley_viz.words.plain_words import said
from trolley_viz.words.sentences import StatusLine

HEADLINE = "The robot is no longer as its settings say"
DISMISS = "Do not propose it again"
HOW = "On the robot: trolley calibrate proposed --accept {id}, then restart base."


class ProposalPanel:
    """Shows the proposals, to be dismissed here; what the robot is, its owner says on the robot.

    Args:
        actions: ask the robot.
        may_dismiss: whether the page's person may.
    """

    def __init__(self, gui: Controls, actions: RobotActions, *, may_dismiss: bool) -> None:
        self._actions, self._may_dismiss = actions, may_dismiss
        self._text = gui.add_html("", visible=False)
        self._text.on_press(self._dismiss)

    def update(self, view: View) -> None:
        """Show what is proposed now."""
        heard = view.streams.latest(topics.PROPOSALS)
        proposals = [] if heard is None else heard.proposals
        self._text.visible = bool(proposals)
        shown = card(proposals, may_dismiss=self._may_dismiss) if proposals else ""
        self._text.content = shown

    def _dismiss(self, chosen: str) -> None:
        params = WhichProposal(id=chosen)
        self._actions.ask(requests.PROPOSALS_DISMISS, params, "Not dismissed")


def card(proposals: list[Proposal], *, may_dismiss: bool) -> str:
    """What has been found, each with what to do, as HTML."""
    lines: list[str] = []
    for one in proposals:
        lines.append(note(said(one.message)))
        if one.settings:
            lines.append(note(HOW.format(id=one.id)))
        if may_dismiss:
            lines.append(lead(one.id, DISMISS))
    return row(StatusLine(HEADLINE, "warn")) + "".join(lines)
