"""What base has found wrong with robot.toml while the robot drove, and how to set it right."""

from trolley import requests, topics
from trolley.messages import Proposal
from trolley.messages.request_params import WhichProposal
from trolley_viz.controls.controls import Controls
from trolley_viz.panels.markup import lead, note, row
from trolley_viz.plain_words import said
from trolley_viz.robots.view import View
from trolley_viz.sentences import StatusLine
from trolley_viz.session.session import Session

HEADLINE = "The robot is no longer as its settings say"
DISMISS = "Do not propose it again"
HOW = "On the robot: trolley calibrate proposed --accept {id}, then restart base."


class ProposalPanel:
    """Shows the proposals, to be dismissed here; what the robot is, its owner says on the robot."""

    def __init__(self, gui: Controls, session: Session) -> None:
        self._session = session
        self._text = gui.add_html("", visible=False)
        self._text.on_press(self._dismiss)

    def update(self, view: View) -> None:
        """Show what is proposed now."""
        heard = view.streams.latest(topics.PROPOSALS)
        proposals = [] if heard is None else heard.proposals
        self._text.visible = bool(proposals)
        may_dismiss = self._session.may_drive
        self._text.content = card(proposals, may_dismiss=may_dismiss) if proposals else ""

    def _dismiss(self, chosen: str) -> None:
        params = WhichProposal(id=chosen)
        self._session.actions.ask(requests.PROPOSALS_DISMISS, params, "Not dismissed")


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
