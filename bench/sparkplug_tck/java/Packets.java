import com.hivemq.extension.sdk.api.packets.connect.ConnectPacket;
import com.hivemq.extension.sdk.api.packets.connect.WillPublishPacket;
import com.hivemq.extension.sdk.api.packets.disconnect.DisconnectPacket;
import com.hivemq.extension.sdk.api.packets.disconnect.DisconnectReasonCode;
import com.hivemq.extension.sdk.api.packets.general.MqttVersion;
import com.hivemq.extension.sdk.api.packets.general.Qos;
import com.hivemq.extension.sdk.api.packets.publish.PublishPacket;
import com.hivemq.extension.sdk.api.packets.subscribe.SubscribePacket;
import com.hivemq.extension.sdk.api.packets.subscribe.Subscription;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.List;
import java.util.Optional;

/** The packets of one client, MQTT 3.1.1 and 5, as the objects of HiveMQ's SDK. */
final class Packets {
  static final int CONNECT = 1;
  private static final int PUBLISH = 3;
  private static final int SUBSCRIBE = 8;
  private static final int DISCONNECT = 14;
  private static final int WITH_WILL = 4; // reason code of a DISCONNECT

  private int version = 4; // of the protocol: 4 is 3.1.1

  record Connect(String clientId, ConnectPacket packet) {}

  Connect connect(byte[] body) {
    ByteBuffer in = ByteBuffer.wrap(body);
    text(in); // "MQTT"
    version = in.get();
    int flags = in.get();
    int keepAlive = in.getShort() & 0xFFFF;
    long expiry = properties(in);
    String clientId = text(in);
    Optional<WillPublishPacket> will = Optional.empty();
    if ((flags & 4) != 0) {
      properties(in);
      will = Optional.of(Fake.of(WillPublishPacket.class, "getTopic", text(in), "getPayload", payload(binary(in)),
          "getQos", Qos.valueOf(flags >> 3 & 3), "getRetain", (flags & 32) != 0));
    }
    MqttVersion named = version == 5 ? MqttVersion.V_5 : MqttVersion.V_3_1_1;
    return new Connect(clientId,
        Fake.of(ConnectPacket.class, "getClientId", clientId, "getCleanStart", (flags & 2) != 0,
            "getSessionExpiryInterval", expiry, "getMqttVersion", named, "getWillPublish", will, "getKeepAlive",
            keepAlive));
  }

  /** Tells the TCK of a packet other than CONNECT, if it asks for that kind. */
  void tell(String clientId, int header, byte[] body) {
    ByteBuffer in = ByteBuffer.wrap(body);
    switch (header >> 4) {
      case PUBLISH:
        String topic = text(in);
        PublishPacket publish = publish(header, topic, in);
        Shim.tell(() -> Shim.tck.publish(clientId, publish));
        Shim.say("PUBLISH", topic);
        break;
      case SUBSCRIBE:
        SubscribePacket subscribe = subscribe(in);
        Shim.tell(() -> Shim.tck.subscribe(clientId, subscribe));
        break;
      case DISCONNECT:
        boolean will = version == 5 && in.hasRemaining() && in.get() == WITH_WILL;
        DisconnectPacket disconnect =
            Fake.of(DisconnectPacket.class, "getReasonCode", will
                ? DisconnectReasonCode.DISCONNECT_WITH_WILL_MESSAGE : DisconnectReasonCode.NORMAL_DISCONNECTION);
        Shim.tell(() -> Shim.tck.disconnect(clientId, disconnect));
        break;
      default:
    }
  }

  private PublishPacket publish(int header, String topic, ByteBuffer in) {
    int qos = header >> 1 & 3;
    if (qos > 0) in.getShort(); // packet identifier
    properties(in);
    byte[] rest = new byte[in.remaining()];
    in.get(rest);
    return Fake.of(PublishPacket.class, "getTopic", topic, "getQos", Qos.valueOf(qos), "getRetain", (header & 1) != 0,
        "getPayload", payload(rest), "getDupFlag", (header & 8) != 0);
  }

  private SubscribePacket subscribe(ByteBuffer in) {
    in.getShort(); // packet identifier
    properties(in);
    List<Subscription> wanted = new ArrayList<>();
    while (in.hasRemaining()) {
      String filter = text(in);
      wanted.add(Fake.of(Subscription.class, "getTopicFilter", filter, "getQos", Qos.valueOf(in.get() & 3)));
    }
    return Fake.of(SubscribePacket.class, "getSubscriptions", wanted);
  }

  /** A fresh view for each reader. */
  private static Fake.Answer payload(byte[] bytes) {
    return arguments -> Optional.of(ByteBuffer.wrap(bytes).asReadOnlyBuffer());
  }

  /** Skips the properties of MQTT 5; the session expiry interval in s among them, 0 without one. */
  private long properties(ByteBuffer in) {
    if (version != 5) return 0;
    int length = 0;
    for (int shift = 0, digit = 128; (digit & 128) != 0; shift += 7) {
      digit = in.get();
      length |= (digit & 127) << shift;
    }
    int end = in.position() + length;
    long expiry = 0;
    while (in.position() < end) {
      switch (in.get()) {
        case 0x11: // session expiry interval
          expiry = in.getInt() & 0xFFFFFFFFL;
          break;
        case 0x02, 0x18, 0x27: // 4 bytes
          in.getInt();
          break;
        case 0x21, 0x22, 0x23: // 2 bytes
          in.getShort();
          break;
        case 0x01, 0x17, 0x19: // 1 byte
          in.get();
          break;
        case 0x0B: // subscription identifier: a variable length, and nothing here needs what follows
          in.position(end);
          break;
        case 0x26: // user property: two texts
          binary(in);
          binary(in);
          break;
        default: // text or bytes
          binary(in);
      }
    }
    in.position(end);
    return expiry;
  }

  private static String text(ByteBuffer in) {
    return new String(binary(in), StandardCharsets.UTF_8);
  }

  private static byte[] binary(ByteBuffer in) {
    byte[] found = new byte[in.getShort() & 0xFFFF];
    in.get(found);
    return found;
  }
}
