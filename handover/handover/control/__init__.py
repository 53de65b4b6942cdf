"""Control of robots by people: what the services that control robots, and those that pass on inputs, share.

- `dead_man`: motion only while a control is held and its messages arrive.
- `lease`: one person at a time per robot, hand-over and take-over.
- `speed_limits`: limits from people, aged by the clock, which only ever lower the speed.
- `latest_input`, `control_link`: inputs on their way to the service of the robot; the newest one counts.
"""
