"""What is told of a Modbus server's connections: one row an address, bounded, PLCs first."""

from gateway.modbus.server.traffic import MOST_PEERS, PeerNow, peers


def test_connections_of_one_address_are_one_row() -> None:
    connections = [
        PeerNow("10.0.0.1", False, 1, 5, 9.0),
        PeerNow("10.0.0.2", False, 1, 1, 3.0),
        PeerNow("10.0.0.1", False, 1, 7, 1.0),
    ]
    assert peers(connections) == (
        PeerNow("10.0.0.1", False, 2, 12, 1.0),
        PeerNow("10.0.0.2", False, 1, 1, 3.0),
    )


def test_of_many_the_plcs_and_the_busy_ones_are_told() -> None:
    crowd = [PeerNow(f"10.0.1.{n}", False, 1, 1, float(n)) for n in range(200)]
    told = peers([*crowd, PeerNow("10.0.0.1", True, 1, 0, 500.0)])
    assert len(told) == MOST_PEERS
    assert told[0].address == "10.0.0.1"
    assert [peer.quiet_s for peer in told[1:]] == [float(n) for n in range(MOST_PEERS - 1)]


def test_nobody_is_nobody() -> None:
    assert peers([]) == ()
