"""What `health` says is wrong with the service."""

from trolley.runtime.service import Service


class Problems:
    """One sentence per thing that is wrong; the service is degraded while there is any."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._sentences: dict[str, str] = {}

    def set(self, about: str, sentence: str | None) -> None:
        """Report what is wrong with something, or None once it is well again."""
        if sentence is None:
            self._sentences.pop(about, None)
        else:
            self._sentences[about] = sentence
        if self._sentences:
            self._service.set_health("degraded", " ".join(self._sentences.values()))
        else:
            self._service.set_health("ok")
