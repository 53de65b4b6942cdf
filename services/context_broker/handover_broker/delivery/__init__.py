"""Subscriptions and their notifications: matching, queues, delivery over HTTP and MQTT."""
