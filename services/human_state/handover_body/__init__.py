"""Human state: body signals become features, a state of each person, and speed limits for robots.

    driver > Samples > Feature > HumanState > SpeedLimit

The parts are layers, lowest first: `model` (values), `processing` (signal to feature), `drivers` (devices,
recordings, simulators), `fusion` (features of several sensors to the state of a person), `limits` (state to
limit), `people` (consent and what belongs to a person), `exchange` (NGSI-LD, FHIR, LSL, MCAP), `recording`,
`monitoring` (runs what consent allows), `cases`, `routes`, and `app.py`, which wires them.

Nothing here is a medical device or a safety-rated function.
"""
