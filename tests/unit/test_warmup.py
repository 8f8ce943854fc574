"""Compiling the kernels at set-up."""

import pytest

from trolley import warmup


def test_every_part_is_named_as_it_is_compiled(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[str] = []
    parts = {"common": lambda: called.append("common"), "base": lambda: called.append("base")}
    monkeypatch.setattr(warmup, "warm_ups", lambda: parts)
    warmup.main()
    assert called == ["common", "base"]
    assert "[2/2] base ..." in capsys.readouterr().out


def test_services_with_kernels_bring_their_warm_up() -> None:
    parts = warmup.warm_ups()
    assert {"common", "localizer", "planner"} <= set(parts)
    assert not {"tour", "viz"} & set(parts)
    parts["common"]()
