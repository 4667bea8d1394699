"""The Modbus TCP server: listeners, TLS, connections and their limits. IO."""
