"""The tree of coordinate frames.

All frames are right-handed, x forward or east, y left or north, z up, in metres and radians
(REP-103, REP-105):

| frame | moves with | origin and axes | link to its parent |
|---|---|---|---|
| `map` | nothing | fixed by the map; poses, zones and goals are given in it | the root |
| `odom` | nothing, but drifts | where the odometry began; never jumps | `tf/odom`, in `map` |
| `base_link` | the robot | between the driven wheels, on the floor, x forward | `odom` |
| `laser` | the robot | the lidar's centre, x along beam angle 0 | `tf/laser`, in `base_link` |
| `grid` | nothing | outer corner of a map's cell (0, 0), x along columns | the map's `origin` |

A link holds `parent_T_child`: it maps points of the child to the parent.
"""

import msgspec

from trolley.geometry.pose import Pose2D

MAP = "map"
ODOM = "odom"
BASE = "base_link"
LASER = "laser"


class Link(msgspec.Struct, frozen=True):
    """One edge of the tree."""

    parent: str
    child: str
    pose: Pose2D
    """`parent_T_child`."""
    stamp_ns: int | None
    """Robot time that the pose holds for [ns]; None for a mounting that never changes."""


class MissingLink(LookupError):
    """Two frames are not connected.

    Attributes:
        parent: the frame asked for.
        child: the frame asked from.
        missing: the frame whose link to a parent is missing.
    """

    def __init__(self, parent: str, child: str, missing: str, message: str) -> None:
        super().__init__(message)
        self.parent = parent
        self.child = child
        self.missing = missing


class FrameTree:
    """Links between frames, and the transforms that follow from them."""

    def __init__(self) -> None:
        self._links: dict[str, Link] = {}

    def set(self, parent: str, child: str, pose: Pose2D, stamp_ns: int | None = None) -> None:
        """Set or replace the link from a frame to its parent.

        Args:
            parent: frame that the pose is given in; a leading '/' is dropped.
            child: frame that is placed; it leaves its former parent.
            pose: `parent_T_child`.
            stamp_ns: robot time that the pose holds for [ns]; None: forever.

        Raises:
            ValueError: an empty name, or the link would close a loop.
        """
        parent, child = parent.removeprefix("/"), child.removeprefix("/")
        if not parent or not child:
            raise ValueError("a frame needs a name")
        if parent == child:
            raise ValueError(f"frame '{child}' cannot be its own parent")
        if child in self._ancestors(parent):
            raise ValueError(
                f"frame '{child}' cannot be a child of '{parent}', which descends from it"
            )
        self._links[child] = Link(parent, child, pose, stamp_ns)

    def remove(self, child: str) -> None:
        """Forget the link from a frame to its parent, if there is one."""
        self._links.pop(child.removeprefix("/"), None)

    def clear(self) -> None:
        """Forget all links."""
        self._links.clear()

    def link(self, child: str) -> Link | None:
        """Return the link from a frame to its parent, or None for a root or unknown frame."""
        return self._links.get(child.removeprefix("/"))

    def frames(self) -> list[str]:
        """Return the names of all frames that any link mentions, sorted."""
        return sorted(self._links.keys() | {link.parent for link in self._links.values()})

    def lookup(self, parent: str, child: str) -> Pose2D:
        """Return `parent_T_child`, which maps points of frame `child` to frame `parent`.

        The frames may be anywhere in the tree, also the other way up or on two branches.

        Raises:
            MissingLink: they are not connected; the text names the link that is missing.
        """
        at = parent.removeprefix("/")
        parent_T_at = Pose2D.identity()
        for link in self.chain(parent, child):
            if link.child == at:
                parent_T_at, at = parent_T_at @ link.pose.inverse(), link.parent
            else:
                parent_T_at, at = parent_T_at @ link.pose, link.child
        return parent_T_at

    def chain(self, parent: str, child: str) -> list[Link]:
        """Return the links between two frames, in order from `parent` to `child`.

        The age of what `lookup` returns is that of the oldest stamp among them.

        Raises:
            MissingLink: they are not connected.
        """
        parent, child = parent.removeprefix("/"), child.removeprefix("/")
        up, down = self._ancestors(parent), self._ancestors(child)
        above_parent = set(up)
        common = next((frame for frame in down if frame in above_parent), None)
        if common is None:
            raise self._missing(parent, child, up[-1], down[-1])
        climbing = [self._links[frame] for frame in up[: up.index(common)]]
        descending = [self._links[frame] for frame in down[: down.index(common)]]
        return climbing + descending[::-1]

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, its parent's parent ... up to the root."""
        path = [frame]
        while (link := self._links.get(path[-1])) is not None:
            path.append(link.parent)
        return path

    def _missing(self, parent: str, child: str, parent_root: str, child_root: str) -> MissingLink:
        """Say which link would join two trees."""
        known = self.frames()
        # `map` never gets a parent, so what is missing is the parent of the other root.
        missing, other = (
            (parent_root, child_root) if child_root == MAP else (child_root, parent_root)
        )
        reason = f"'{missing}' has no parent, so nothing connects it to '{other}'"
        unknown = [frame for frame in (child, parent) if frame not in known and frame != MAP]
        if unknown:
            missing = unknown[0]
            names = " and ".join(f"'{frame}'" for frame in unknown)
            reason = f"nothing is known of {names} yet"
        return MissingLink(
            parent,
            child,
            missing,
            f"frames '{parent}' and '{child}' are not connected: {reason} "
            f"(missing: tf/{missing}; known frames: {', '.join(known) or 'none'})",
        )
