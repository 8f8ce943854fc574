"""What a tool answers: a sentence, more as data, a picture; or a refusal with advice."""

import base64
from typing import Any

import msgspec
from mcp_types import CallToolResult, ImageContent, TextContent

from trolley import codes
from trolley.codes import Refused
from trolley.sanitize import sanitize
from trolley_mcp.limits import TOO_MANY

NOT_ALLOWED = "not_allowed"
"""Code of what the session's role or the settings do not allow."""
NOT_STOPPED = "not_stopped"
"""Code of a stop that nobody has answered."""
LONGEST = 4000
"""Characters of a text; more would only fill the assistant's memory."""

REMEDIES: dict[str, str] = {
    codes.BAD_REQUEST: "Correct the arguments as the tool describes them.",
    codes.UNKNOWN_NAME: "List the names with `places`, `tours` or `zones`, and use one of those.",
    codes.NOT_READY: "Call `status`: it says what is missing. Ask a person if it stays so.",
    codes.TIMEOUT: "Call `status`, and try again once if the robot is there.",
    codes.INTERNAL: "Tell a person: the robot's log has the details.",
    codes.LOST: "Ask a person to set the robot's pose in the viewer.",
    codes.STALE: "Wait a few seconds and try again.",
    codes.MOVING: "Wait until the robot stands, then try again.",
    codes.NOT_CONVERGED: "Let the robot drive a little, then try again.",
    codes.EXISTS: "Choose another name; only a person replaces what is saved.",
    codes.OUTSIDE_MAP: "Choose a place on the map: `map` shows it.",
    codes.IN_OBSTACLE: "Choose another place, or ask a person to clear that one.",
    codes.WRONG_MAP: "Choose a place on the robot's present map: `places` lists them.",
    codes.MAPPING: "Call `finish_map` or `cancel_map` first.",
    codes.NOT_MAPPING: "Call `start_map` first.",
    codes.KEEPOUT: "Choose a place outside the no-go areas: `zones` lists them.",
    codes.NO_PATH: "Ask a person whether a door is closed, or choose another place.",
    codes.NOT_LOCALIZED: "Ask a person to set the robot's pose in the viewer.",
    codes.STOPPED: "Ask a person to let it drive again: `trolley resume`, or the viewer.",
    codes.BUTTON: "Ask a person to let it drive again: `trolley resume`, or the viewer.",
    codes.NOT_CURRENT: "Nothing is under way any more: call `status`.",
    codes.NOT_DRIVING: "Nothing is under way: call `status`.",
    codes.RESTARTED: "Ask whether it is still wanted, then call it again.",
    codes.REPLACED: "Somebody sent the robot elsewhere: ask before you send it again.",
    codes.CANCELED: "Somebody canceled it: ask before you send it again.",
    codes.PAUSED: "A person resumes it, or ends it; call `status` for how it stands.",
    codes.TAKEN_OVER: "Wait until nobody drives it by hand, and ask before you send it again.",
    codes.BLOCKED: "Ask a person to clear the path, then send it again.",
    codes.BUSY: "Wait until it has arrived, or ask a person and call again with `replace`.",
    codes.LOW_BATTERY: "Let it charge.",
    codes.BATTERY: "Ask a person to charge it.",
    codes.DOES_NOT_OBEY: "Ask a person to switch the robot off at once.",
    NOT_STOPPED: "Tell a person at once, and call `stop` again.",
    TOO_MANY: "Wait as long, then call once; `stop` always works.",
    NOT_ALLOWED: "Ask a person to do it, or to change the section [mcp] of robot.toml.",
}
"""By code, what an assistant does about a refusal."""
ELSE = "Tell a person what happened; do not call it again unchanged."


class Answer(msgspec.Struct, frozen=True):
    """What came of a call."""

    text: str
    data: dict[str, Any] = {}
    """What the text leaves out."""
    picture: bytes | None = None
    """A PNG."""


def clean(text: str) -> str:
    """A text from outside without anything that is not printable."""
    return sanitize(text, LONGEST)


def _clean_all(value: Any) -> Any:
    match value:
        case str():
            return clean(value)
        case dict():
            return {clean(str(key)): _clean_all(one) for key, one in value.items()}
        case list() | tuple():
            return [_clean_all(one) for one in value]
        case float():
            return round(value, 3)
        case _:
            return value


def result_of(answer: Answer) -> CallToolResult:
    """An answer in the protocol's words.

    The data is a text, too: where there is structured content, several assistants show their model
    that alone, without the sentence and the picture.
    """
    lines = "\n".join(clean(line) for line in answer.text.split("\n"))
    content: list[Any] = [TextContent(type="text", text=lines)]
    if answer.data:
        data = msgspec.json.encode(_clean_all(answer.data)).decode()
        content.append(TextContent(type="text", text=data))
    if answer.picture is not None:
        data = base64.b64encode(answer.picture).decode()
        content.append(ImageContent(type="image", data=data, mime_type="image/png"))
    return CallToolResult(content=content)


def refusal_of(refused: Refused) -> CallToolResult:
    """A refusal in the protocol's words: code, sentence, and what to do."""
    text = f"{refused.code}: {clean(refused.message)} {REMEDIES.get(refused.code, ELSE)}"
    return CallToolResult(content=[TextContent(type="text", text=text)], is_error=True)
