"""MQTT. Pure: topics, topic_plan, messages, payloads, home_assistant.

IO: broker (reads files), broker_socket, broker_link (imports the client library), session, publisher.
"""
