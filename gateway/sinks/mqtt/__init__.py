"""MQTT. Pure: topics, address, payloads, outbox, reference. IO: dial, link (imports the client library), publisher."""
