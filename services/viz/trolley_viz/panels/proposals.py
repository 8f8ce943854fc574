"""What base has found wrong with robot.toml while the robot drove, and how to set it right."""

from trolley import topics
from trolley.messages import Proposal
from trolley_viz.controls.controls import Controls
from trolley_viz.panels.markup import note, row
from trolley_viz.plain_words import said
from trolley_viz.robots.view import View
from trolley_viz.sentences import StatusLine

HEADLINE = "The robot is no longer as its settings say"
HOW = "On the robot: trolley calibrate proposed --accept {id}, then restart base."


class ProposalPanel:
    """Shows the proposals. The page only tells: what the robot is, its owner says on the robot."""

    def __init__(self, gui: Controls) -> None:
        self._text = gui.add_html("", visible=False)

    def update(self, view: View) -> None:
        """Show what is proposed now."""
        heard = view.streams.latest(topics.PROPOSALS)
        proposals = [] if heard is None else heard.proposals
        self._text.visible = bool(proposals)
        self._text.content = card(proposals) if proposals else ""


def card(proposals: list[Proposal]) -> str:
    """What has been found, each with what to do, as HTML."""
    lines: list[str] = []
    for one in proposals:
        lines.append(note(said(one.message)))
        if one.settings:
            lines.append(note(HOW.format(id=one.id)))
    return row(StatusLine(HEADLINE, "warn")) + "".join(lines)
