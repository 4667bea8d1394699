import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.net.InetAddress;
import java.net.ServerSocket;
import java.net.Socket;
import java.util.Arrays;
import org.eclipse.sparkplug.tck.test.TCK;
import org.eclipse.sparkplug.tck.test.common.Constants.Profile;

/**
 * Runs one test of the Eclipse Sparkplug TCK without HiveMQ: the TCK's classes, the services that they ask HiveMQ for
 * ({@link Services}), and a proxy before another broker that tells them what its clients send ({@link Connection}).
 *
 * <pre>java -Dbroker=tcp://127.0.0.1:PORT Shim BROKER_PORT TEST PARAMETER...</pre>
 *
 * Standard output, a line each: LISTENING port (of the proxy), BEGUN, PUBLISH topic (by a client), LOG text,
 * RESULT text (the TCK's summary, its last line begins with OVERALL), ERROR text (an exception in the TCK).
 * Standard input: the lines BEGIN and END of the test; until BEGIN the proxy closes every connection. End of file ends
 * the program.
 */
public final class Shim {
  /** The TCK's classes are not written for several threads: every call of them holds this. */
  static final Object LOCK = new Object();

  static TCK tck;

  private static volatile boolean begun;

  public static void main(String[] args) throws Exception {
    int brokerPort = Integer.parseInt(args[0]);
    Services.install(brokerPort);
    tck = new TCK();
    ServerSocket listener = new ServerSocket(0, 50, InetAddress.getLoopbackAddress());
    new Thread(() -> accept(listener, brokerPort)).start();
    say("LISTENING", Integer.toString(listener.getLocalPort()));
    BufferedReader commands = new BufferedReader(new InputStreamReader(System.in));
    for (String line; (line = commands.readLine()) != null; ) {
      if (line.equals("BEGIN")) {
        tell(() -> tck.newTest(Profile.EDGE, args[1], Arrays.copyOfRange(args, 2, args.length)));
        begun = true;
        say("BEGUN", "");
      } else if (line.equals("END")) {
        tell(() -> tck.endTest());
      }
    }
    System.exit(0);
  }

  private static void accept(ServerSocket listener, int brokerPort) {
    try {
      while (true) {
        Socket client = listener.accept();
        if (begun) new Thread(() -> new Connection(client, brokerPort).run()).start();
        else client.close();
      }
    } catch (java.io.IOException e) {
      say("ERROR", e.toString());
    }
  }

  /** Calls the TCK; what it throws is reported, as HiveMQ would log it. */
  static void tell(Runnable call) {
    synchronized (LOCK) {
      try {
        call.run();
      } catch (RuntimeException e) {
        say("ERROR", e.toString());
        e.printStackTrace();
      }
    }
  }

  static void say(String kind, String text) {
    synchronized (System.out) {
      for (String line : text.strip().split("\\R")) System.out.println((kind + " " + line).strip());
      System.out.flush();
    }
  }
}
