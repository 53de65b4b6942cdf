"""The trajectory tool: Tasks become robot motion.

From the top; a folder imports only those below it (`pyproject.toml` has the contract):

    app                   what runs: performers, REST, checks of health
    routes, case_study    REST and WebSockets; the trials of the case study
    tasks, control        what robots do for Tasks, and what people do with them by hand
    cell                  the robots of a cell, with all that they share
    drivers               our drivers, and the registry of all
    physics               a driver with a simulated world
    driver_base           the interface of drivers, and the base of those with control cycles
    people, onboarding    sensors of people; new robots from URDFs
    limits, perception    what limits a motion; parts in depth images
    robots                robots by name, and the reader of URDFs
    planning, scene       collision-free motion; what stands and lies in a cell
    model                 values: joints, poses, shapes, trajectories, the model of a robot
"""
