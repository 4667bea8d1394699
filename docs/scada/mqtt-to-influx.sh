#!/bin/sh
# Writes the states and events of all bays into InfluxDB 1.x or VictoriaMetrics. Needs mosquitto-clients, jq and curl.
#   mqtt-to-influx.sh BROKER PORT URL      URL: http://influx:8086/write?db=plant  or  http://victoria:8428/write
set -u
here=$(dirname "$0")
# -R: a retained state is not new. -c -q 1: the broker keeps events while this program is away. The longer topics are those
# of gateways with area and line.
mosquitto_sub -h "$1" -p "$2" -q 1 -c -i mqtt-to-influx -R -t 'loading/+/+/state' -t 'loading/+/+/event' \
    -t 'loading/+/+/+/+/state' -t 'loading/+/+/+/+/event' |
  jq --unbuffered -r -f "$here/line-protocol.jq" |
  while IFS= read -r line; do
    while :; do
      code=$(printf '%s\n' "$line" | curl -sS -o /dev/null -w '%{http_code}' --max-time 10 --data-binary @- "$3")
      case $code in
        2??) break ;;
        400 | 413 | 422) echo "skipped, refused with $code: $line" >&2; break ;;  # it would be refused again, and hold up all
      esac
      sleep 1
    done
  done
