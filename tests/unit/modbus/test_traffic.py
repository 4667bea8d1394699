"""How a Modbus server's connections are listed: one row an address, bounded, PLCs first."""

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


def test_of_many_the_plcs_and_the_busy_ones_are_listed() -> None:
    crowd = [PeerNow(f"10.0.1.{n}", False, 1, 1, float(n)) for n in range(200)]
    listed = peers([*crowd, PeerNow("10.0.0.1", True, 1, 0, 500.0)])
    assert len(listed) == MOST_PEERS
    assert listed[0].address == "10.0.0.1"
    assert [peer.quiet_s for peer in listed[1:]] == [float(n) for n in range(MOST_PEERS - 1)]


def test_no_connections_give_no_rows() -> None:
    assert peers([]) == ()
