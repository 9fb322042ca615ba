"""What runs, for the plant's systems: OPC UA, MQTT and Foxglove, in a process of their own."""
