"""Do two things at once with asyncio: drive, and say how the robot's pose changes meanwhile."""

import asyncio

from trolley import AsyncRobot, Refused


async def tell(robot: AsyncRobot) -> None:
    """Print each pose until the task is cancelled."""
    async for estimate in robot.poses():
        print(estimate.state, estimate.pose)


async def main() -> None:
    """Drive to the kitchen."""
    async with AsyncRobot() as robot:
        telling = asyncio.create_task(tell(robot))
        try:
            status = await robot.go_to("kitchen")
            print(f"{status.state} after {status.elapsed:.0f} s")
        except Refused as refused:
            print(refused.message)
        telling.cancel()


asyncio.run(main())
