import asyncio
import threading
from dataclasses import dataclass

from viser.infra import Message

from trolley_viz.server.scene_buffer import LoopEvent, SceneBuffer


@dataclass
class Said(Message):
    number: int

    def redundancy_key(self) -> str:
        return str(self.number)


def test_a_page_hears_what_another_thread_says_while_it_is_about_to_wait() -> None:
    """Set in between, the event told no page of anything any more."""
    heard: list[int] = []

    async def listen() -> None:
        buffer = SceneBuffer(asyncio.get_running_loop(), persistent_messages=True)

        class Event(LoopEvent):
            def _get_loop(self) -> asyncio.AbstractEventLoop:
                """Called between the look and the wait."""
                if len(heard) == 1 and buffer.message_counter == 1:
                    other = threading.Thread(target=lambda: buffer.push(Said(2)))
                    other.start()
                    other.join()
                return super()._get_loop()  # type: ignore[misc]

        buffer.message_event = Event(buffer.event_loop)
        buffer.push(Said(1))
        async for window in buffer.window_generator(0):
            heard.extend(one.number for one in window if isinstance(one, Said))
            if 2 in heard:
                return

    asyncio.run(asyncio.wait_for(listen(), 10.0))
    assert heard == [1, 2]
