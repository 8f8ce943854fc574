"""The picture that one page shows: viser's connection of that page, which comes and goes."""

import viser


class Picture:
    """Viser's connection of one page: there the page draws what nobody else sees."""

    client: viser.ClientHandle | None = None
    """None while viser's part of the page loads, or is gone."""

    @property
    def scene(self) -> viser.SceneApi | None:
        """Where to draw."""
        return None if self.client is None else self.client.scene

    def is_of(self, client_id: int) -> bool:
        """Whether this connection of viser's is the page's."""
        return self.client is not None and self.client.client_id == client_id
