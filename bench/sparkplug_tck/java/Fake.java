import java.lang.reflect.Proxy;
import java.util.HashMap;
import java.util.Map;

/** Makes an object of any interface from the answers of the methods that are used; all others throw. */
final class Fake {
  /** An answer that is computed, from the method's arguments. */
  interface Answer {
    Object of(Object[] arguments) throws Exception;
  }

  /** answers: name of a method, its answer (a value, or an {@link Answer}), and so on. */
  static <T> T of(Class<T> type, Object... answers) {
    Map<String, Object> known = new HashMap<>();
    for (int n = 0; n < answers.length; n += 2) known.put((String) answers[n], answers[n + 1]);
    return type.cast(
        Proxy.newProxyInstance(
            Fake.class.getClassLoader(),
            new Class<?>[] {type},
            (self, method, arguments) -> {
              switch (method.getName()) {
                case "toString":
                  return type.getSimpleName() + known;
                case "hashCode":
                  return System.identityHashCode(self);
                case "equals":
                  return self == arguments[0];
                default:
              }
              if (!known.containsKey(method.getName())) {
                throw new UnsupportedOperationException(type.getSimpleName() + "." + method.getName());
              }
              Object answer = known.get(method.getName());
              return answer instanceof Answer ? ((Answer) answer).of(arguments) : answer;
            }));
  }
}
