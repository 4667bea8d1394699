import com.hivemq.extension.sdk.api.packets.general.Qos;
import com.hivemq.extension.sdk.api.services.ManagedExtensionExecutorService;
import com.hivemq.extension.sdk.api.services.admin.AdminService;
import com.hivemq.extension.sdk.api.services.admin.LifecycleStage;
import com.hivemq.extension.sdk.api.services.builder.Builders;
import com.hivemq.extension.sdk.api.services.builder.PublishBuilder;
import com.hivemq.extension.sdk.api.services.publish.Publish;
import com.hivemq.extension.sdk.api.services.publish.PublishService;
import com.hivemq.extension.sdk.api.services.publish.RetainedMessageStore;
import com.hivemq.extension.sdk.api.services.publish.RetainedPublish;
import com.hivemq.extension.sdk.api.services.session.ClientService;
import java.lang.reflect.Field;
import java.nio.ByteBuffer;
import java.nio.charset.StandardCharsets;
import java.util.HashMap;
import java.util.Map;
import java.util.Optional;
import java.util.concurrent.Callable;
import java.util.concurrent.CompletableFuture;
import java.util.concurrent.ConcurrentHashMap;
import java.util.concurrent.Executors;
import java.util.concurrent.ScheduledExecutorService;
import java.util.concurrent.TimeUnit;
import java.util.function.Supplier;
import org.eclipse.paho.client.mqttv3.MqttClient;
import org.eclipse.paho.client.mqttv3.persist.MemoryPersistence;

/** The services of HiveMQ's extension SDK that the TCK uses, on another broker. */
final class Services {
  private static final ScheduledExecutorService LATER = Executors.newScheduledThreadPool(2);
  private static final Map<String, byte[]> RETAINED = new ConcurrentHashMap<>();
  private static MqttClient client;

  /** Puts them where the SDK looks for them. */
  static void install(int brokerPort) throws Exception {
    client = new MqttClient("tcp://127.0.0.1:" + brokerPort, "tck-services", new MemoryPersistence());
    client.connect();
    client.subscribe("spBv1.0/STATE/#", 1, (topic, message) -> RETAINED.put(topic, message.getPayload()));
    Map<String, Object> services = new HashMap<>();
    put(services, AdminService.class, Fake.of(AdminService.class, "getCurrentStage", LifecycleStage.STARTED_SUCCESSFULLY));
    Fake.Answer publish = arguments -> publish((Publish) arguments[0]);
    put(services, PublishService.class, Fake.of(PublishService.class, "publish", publish));
    Fake.Answer schedule =
        arguments -> {
          Object task = arguments[0];
          LATER.schedule(() -> run(task), (Long) arguments[1], (TimeUnit) arguments[2]);
          return null;
        };
    put(services, ManagedExtensionExecutorService.class,
        Fake.of(ManagedExtensionExecutorService.class, "schedule", schedule));
    Fake.Answer retained = arguments -> retained((String) arguments[0]);
    put(services, RetainedMessageStore.class, Fake.of(RetainedMessageStore.class, "getRetainedMessage", retained));
    Fake.Answer disconnect =
        arguments -> CompletableFuture.completedFuture(Connection.disconnect((String) arguments[0]));
    put(services, ClientService.class, Fake.of(ClientService.class, "disconnectClient", disconnect));
    set(com.hivemq.extension.sdk.api.services.Services.class, "services", services);
    Map<String, Supplier<Object>> builders = new HashMap<>();
    builders.put(PublishBuilder.class.getCanonicalName(), Services::publishBuilder);
    set(Builders.class, "builders", builders);
  }

  private static <T> void put(Map<String, Object> services, Class<T> type, T service) {
    services.put(type.getCanonicalName(), service);
  }

  private static void set(Class<?> owner, String name, Object value) throws ReflectiveOperationException {
    Field field = owner.getDeclaredField(name);
    field.setAccessible(true);
    field.set(null, value);
  }

  private static void run(Object task) {
    Shim.tell(
        () -> {
          try {
            if (task instanceof Runnable) ((Runnable) task).run();
            else ((Callable<?>) task).call();
          } catch (Exception e) {
            throw new IllegalStateException(e);
          }
        });
  }

  /** What the TCK has to say is printed; all else is a command to the edge node. */
  private static CompletableFuture<Void> publish(Publish message) {
    byte[] payload = bytes(message.getPayload().orElseThrow());
    String topic = message.getTopic();
    String text = new String(payload, StandardCharsets.UTF_8);
    if (topic.equals("SPARKPLUG_TCK/RESULT")) Shim.say("RESULT", text);
    else if (topic.startsWith("SPARKPLUG_TCK/")) Shim.say("LOG", text);
    else LATER.execute(() -> send(topic, payload, message.getQos().getQosNumber(), message.getRetain()));
    return CompletableFuture.completedFuture(null);
  }

  private static void send(String topic, byte[] payload, int qos, boolean retain) {
    try {
      client.publish(topic, payload, qos, retain);
    } catch (org.eclipse.paho.client.mqttv3.MqttException e) {
      Shim.say("ERROR", e.toString());
    }
  }

  private static CompletableFuture<Optional<RetainedPublish>> retained(String topic) {
    byte[] payload = RETAINED.get(topic);
    if (payload == null) return CompletableFuture.completedFuture(Optional.empty());
    ByteBuffer buffer = ByteBuffer.wrap(payload).asReadOnlyBuffer();
    return CompletableFuture.completedFuture(
        Optional.of(Fake.of(RetainedPublish.class, "getTopic", topic, "getPayload", Optional.of(buffer))));
  }

  private static PublishBuilder publishBuilder() {
    Map<String, Object> set = new HashMap<>(Map.of("qos", Qos.AT_MOST_ONCE, "retain", false));
    PublishBuilder[] self = {null};
    Fake.Answer build =
        arguments ->
            Fake.of(Publish.class, "getTopic", set.get("topic"), "getQos", set.get("qos"), "getRetain",
                set.get("retain"), "getPayload", Optional.of(set.get("payload")));
    self[0] =
        Fake.of(PublishBuilder.class, "topic", setter(set, "topic", self), "qos", setter(set, "qos", self), "retain",
            setter(set, "retain", self), "payload", setter(set, "payload", self), "build", build);
    return self[0];
  }

  private static Fake.Answer setter(Map<String, Object> set, String name, PublishBuilder[] self) {
    return arguments -> {
      set.put(name, arguments[0]);
      return self[0];
    };
  }

  private static byte[] bytes(ByteBuffer buffer) {
    byte[] found = new byte[buffer.remaining()];
    buffer.duplicate().get(found);
    return found;
  }
}
