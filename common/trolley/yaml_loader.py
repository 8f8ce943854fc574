"""Reads YAML of which nobody knows who wrote it."""

import yaml

MAX_REFERENCES = 10
"""No description of a map or a robot needs more. Each may double what those before it stand for, so
that a kilobyte would otherwise take hours."""


class FewReferencesLoader(yaml.SafeLoader):
    """PyYAML's safe loader, which refuses files that repeat themselves without end."""

    _num_references = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose the next node.

        Raises:
            yaml.composer.ComposerError: it is one reference too many.
        """
        if self.check_event(yaml.AliasEvent):
            self._num_references += 1
            if self._num_references > MAX_REFERENCES:
                raise yaml.composer.ComposerError(
                    problem=f"more than {MAX_REFERENCES} references such as *name; "
                    "write out what they stand for",
                    problem_mark=self.peek_event().start_mark,
                )
        return super().compose_node(parent, index)
