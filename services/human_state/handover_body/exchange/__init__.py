"""Human state in the formats of others: NGSI-LD, ROS 2, HL7 FHIR, LSL, MCAP, XDF and Foxglove."""
