import com.hivemq.extension.sdk.api.client.parameter.ClientInformation;
import com.hivemq.extension.sdk.api.events.client.parameters.DisconnectEventInput;
import java.io.ByteArrayOutputStream;
import java.io.DataInputStream;
import java.io.IOException;
import java.io.OutputStream;
import java.net.Socket;
import java.util.Map;
import java.util.concurrent.ConcurrentHashMap;

/** A client's connection through the proxy. The TCK is told of each packet before the broker gets it. */
final class Connection {
  private static final Map<String, Connection> OPEN = new ConcurrentHashMap<>(); // by client id

  /** The TCK demands timestamps before the millisecond of arrival; a network takes longer than loopback. */
  private static final long NETWORK_MS = 2;

  private final Socket client;
  private final int brokerPort;
  private OutputStream toBroker;
  private String clientId; // null before its CONNECT

  Connection(Socket client, int brokerPort) {
    this.client = client;
    this.brokerPort = brokerPort;
  }

  void run() {
    try (Socket broker = new Socket("127.0.0.1", brokerPort);
        Socket from = client) {
      from.setTcpNoDelay(true);
      broker.setTcpNoDelay(true);
      toBroker = broker.getOutputStream();
      Thread answers = new Thread(() -> copy(broker));
      answers.start();
      DataInputStream in = new DataInputStream(from.getInputStream());
      Packets packets = new Packets();
      for (int header; (header = in.read()) >= 0; ) {
        ByteArrayOutputStream raw = new ByteArrayOutputStream();
        raw.write(header);
        byte[] body = in.readNBytes(length(in, raw));
        raw.write(body);
        Thread.sleep(NETWORK_MS);
        told(packets, header, body);
        synchronized (this) {
          toBroker.write(raw.toByteArray());
        }
      }
    } catch (IOException | InterruptedException e) {
      // either side is gone: the end of this connection
    } finally {
      ended();
    }
  }

  private void told(Packets packets, int header, byte[] body) {
    if (header >> 4 == Packets.CONNECT) {
      Packets.Connect connect = packets.connect(body);
      clientId = connect.clientId();
      OPEN.put(clientId, this);
      Shim.tell(() -> Shim.tck.connect(clientId, connect.packet()));
    } else {
      packets.tell(clientId, header, body);
    }
  }

  private void ended() {
    if (clientId == null) return;
    OPEN.remove(clientId, this);
    ClientInformation who = Fake.of(ClientInformation.class, "getClientId", clientId);
    Shim.tell(() -> Shim.tck.onDisconnect(Fake.of(DisconnectEventInput.class, "getClientInformation", who)));
  }

  private void copy(Socket broker) {
    try (Socket to = client) {
      broker.getInputStream().transferTo(to.getOutputStream());
    } catch (IOException e) {
      // either side is gone: the end of this connection
    }
  }

  private static int length(DataInputStream in, ByteArrayOutputStream raw) throws IOException {
    int length = 0;
    for (int shift = 0, digit = 128; (digit & 128) != 0; shift += 7) {
      digit = in.readUnsignedByte();
      raw.write(digit);
      length += (digit & 127) << shift;
    }
    return length;
  }

  /** Ends a client's connection; its last will is not published. False: there is none. */
  static boolean disconnect(String clientId) throws IOException {
    Connection found = OPEN.get(clientId);
    if (found == null) return false;
    synchronized (found) {
      found.toBroker.write(new byte[] {(byte) 0xE0, 0}); // DISCONNECT, in its name
    }
    found.client.close();
    return true;
  }
}
