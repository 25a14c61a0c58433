#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""stop.py [SERVER]: stops the entity Cart, and loses it in three ways. What follows each time is printed."""
import sys
import threading

import axon


def yes(is_so):
    return "yes" if is_so else "no"


def begin(cart, service):
    """Starts a task, and returns when the cart moves."""
    task = cart.start(service, Seconds=2.0)
    for update in task:
        if update.progress > 0 or update.final:
            print(f"{service}: {update.state.name}")
            break
    return task


def stop(lab, cart):
    # [stop]
    task = begin(cart, "Drive")
    for receipt in lab.stop("Cart", deadline=1, standstill=5):
        print(f"stopped, confirmed: {yes(receipt.confirmed)}, stands still: {yes(receipt.standstill is not None)}")
    end = task.wait()
    print(f"Drive: {end.state.name}, {end.reason.message}")
    # [end]
    # [rearm]
    try:
        cart.run("Drive")
    except axon.Refused as refused:
        print(f"Drive again: {refused.report.state.name}, {refused.code.name}")
    lab.rearm("Cart")
    print(f"Drive after a rearm: {begin(cart, 'Drive').wait().state.name}")
    # [end]


# [lose]
def lose(lab, cart, service, orphaned, resumed):
    orphaned.clear()
    resumed.clear()
    task = begin(cart, service)
    lab.present = False  # nobody watches the robot: heartbeats end, and the server stops waiting for them after 250 ms
    orphaned.wait()
    lab.present = True  # the library has reconnected by itself, and gets its lease back
    resumed.wait()
    print(f"back, latched: {yes(lab.find('Cart').latched)}")
    return task
# [end]


def main(server=None):
    with axon.connect(server) as lab:
        lab.wait_for("Cart", 10)
        with lab.checkout("Cart") as cart:
            orphaned, resumed = threading.Event(), threading.Event()

            # [news]
            def on_orphaned(reason):
                print(f"orphaned: {reason}")
                orphaned.set()
            cart.on_orphaned(on_orphaned)
            cart.on_resumed(resumed.set)
            # [end]
            stop(lab, cart)
            # [losses]
            drive = lose(lab, cart, "Drive", orphaned, resumed)  # on_client_loss="stop", the default
            print(f"Drive: {drive.wait().state.name}")
            lab.rearm("Cart")
            carry = lose(lab, cart, "Carry", orphaned, resumed)  # on_client_loss="hold"
            carry.resume()
            print(f"Carry: {carry.wait().state.name}")
            park = lose(lab, cart, "Park", orphaned, resumed)  # on_client_loss="finish"
            print(f"Park: {park.wait().state.name}")
            # [end]


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except axon.Refused as refused:
        sys.exit(f"{refused.code.name}: {refused.message}")
