"""The mapping of the broker and bridge that several test modules share."""

BOTH_WAYS = """
ros_to_ngsild:
  body:
    topic: /human/{person}/heart_rate
    type: handover_human_msgs/msg/HeartRate
    entity: HumanState:{info.subject}
    on_change: true
    attributes:
      refPerson: {object: "Person:{info.subject}"}
      heartRate:
        field: rate_bpm
        unit_code: BPM
        dead_band: 1
        sub_attributes:
          status: {field: info.validity, values: {1: valid, 2: stale}, otherwise: implausible}
          quality: {field: info.quality, dead_band: 0.2}
          observedBy: {object: "Device:{info.source}"}
  joints:
    topic: /joint_states
    type: sensor_msgs/JointState
    entity: Device:{header.frame_id}
    attributes:
      elbow: {field: "position[name=elbow]", convert: rad -> deg, round: 1}
      names: name
  level:
    topic: /level
    type: std_msgs/Float64
    entity: Device:r1
    dead_band: 0.5
    attributes: {level: data}
  sensor: {topic: /sensor, type: std_msgs/Float64, entity: Device:r1, attributes: {sensor: data}}
  latched: {topic: /latched, type: std_msgs/Float64, entity: Device:r1, attributes: {latched: data}}
  fleet:
    topic: /{robot}/charge
    type: std_msgs/Float64
    entity: Device:{robot}
    attributes: {charge: data}
  untyped:
    topic: /words
    entity: Device:r1
    attributes: {words: data}
  valve-from-ros: {topic: /valve, type: std_msgs/Float32, entity: Device:valve-1, attributes: {opening: data}}
  paced:
    topic: /paced
    type: std_msgs/Int32
    entity: Device:paced-1
    every_ms: 400
    attributes: {number: data}
ngsild_to_ros:
  wrong: {entity: {type: Device, q: "a==("}, topic: /a, type: std_msgs/Float32, fields: {data: a}}
  valve-to-ros: {entity: Device:valve-1, topic: /valve, type: std_msgs/Float32, fields: {data: opening}}
  speed:
    entity: Device:belt-1
    topic: /belt/speed
    type: std_msgs/Float64
    fields:
      data: {attribute: speed, convert: km/h -> m/s}
  every:
    {entity: Device:counter-1, topic: /count, type: std_msgs/Int32, fields: {data: count}, every_value: true,
     qos: {depth: 1000}}
"""

REQUESTS = """
services:
  reset:
    service: /arm/reset
    type: std_srvs/SetBool
    task: reset
    resource: Device:arm
    request: {data: {attribute: hard, default: false}}
    success: success
    message: message
    outputs: {words: message}
    timeout_s: 4
  lock:
    service: /arm/lock
    type: std_srvs/SetBool
    task: lock
    resource: Device:arm
    request: {data: {attribute: resource.isLocked, required: true}}
  light:
    service: /lamp/on
    type: std_srvs/SetBool
    when: {entity: Device:lamp, attribute: wanted, is: true}
    request: {data: wanted}
    outputs: {answer: message}
actions:
  count:
    action: /arm/count
    type: example_interfaces/Fibonacci
    task: count
    resource: Device:arm
    goal: {order: {attribute: upTo, required: true}}
    feedback: {sequence: sequence}
    outputs: {sequence: sequence}
  hasty:
    action: /arm/count
    type: example_interfaces/Fibonacci
    task: hasty
    resource: Device:arm
    result_timeout_s: 1
  once:
    action: /arm/count
    type: example_interfaces/Fibonacci
    task: once
    resource: Device:arm
    again: false
tasks_from_ros:
  ask:
    service: /ask_for_help
    type: std_srvs/SetBool
    task:
      definition: help
      resources: [Person:anna]
      description: Please help the arm
      parameters: {commandId: {constant: 3}, urgent: data}
    answer: finished
    response: {success: completed, message: {text: "{status} {id}"}}
    timeout_s: 20
"""
