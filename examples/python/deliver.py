#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""deliver.py [SERVER]: lets a shuttle, an arm and a planner deliver a cup together, after a check in which nothing moves."""
import asyncio
import sys

import axon
import axon.aio


# [deliver]
async def main(server=None):
    async with axon.aio.connect(server) as lab:
        await asyncio.gather(*(lab.wait_for(name, 10) for name in ("Shuttle", "Arm", "Planner")))
        delivery = await lab.global_service("Delivery")
        cast = await lab.propose(delivery)
        for role in cast.roles:
            print(f"{role.kind}: {role.name}")
        async with lab.checkout_all([role.entity for role in cast.roles]):
            check = await lab.check_global(delivery, cast)
            print(f"possible: {(await check).state.name}")
            run = await lab.run_global(delivery, cast)
            begun = set()
            async for report in run:
                for step in report.steps:
                    if step.state is not None and step.step not in begun:
                        begun.add(step.step)
                        print(f"{step.name}: {step.service}")
            print(f"Delivery: {report.state.name}, {len(begun)} steps")
# [end]


if __name__ == "__main__":
    try:
        asyncio.run(main(*sys.argv[1:]))
    except axon.Refused as refused:
        sys.exit(f"{refused.code.name}: {refused.message}")
