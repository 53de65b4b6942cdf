"""The driver `ur`: arms of Universal Robots through their controller (RTDE, dashboard, URScript).

Nothing in this package has been run on a real controller; `docs/how-to/universal-robots.md` lists what that
means. The protocols are those that Universal Robots publishes.
"""
