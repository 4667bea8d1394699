# MQTT's states and events as InfluxDB line protocol, for InfluxDB and VictoriaMetrics (docs/scada.md). Times in ns.
# An event's time has its number in the digits below the millisecond: it overwrites itself when it arrives again, and nothing else.
def tag: gsub("(?<c>[ ,=])"; "\\\(.c)");
def text: gsub("[\n\r\t]"; " ") | tojson;
if has("kind") then
  "event,site=\(.site | tag),bay=\(.bay | tag),kind=\(.kind) id=\(.id | text),reason=\(.reason.name | text),stop=\(.stop),detail=\(.detail | text)"
  + " \(.timestamp_ms)\("000000" + (.id | split("-")[1]) | .[-6:])"
else
  "state,site=\(.site | tag),bay=\(.bay | tag) stop=\(.stop),may_move=\(.may_move),in_place=\(.in_place)"
  + ",reason=\(.reason.name | text),ne107=\(.ne107.name | text)"
  + ([to_entries[] | select(.key == ("radius_px", "distance_mm", "u", "v") and .value != null) | ",\(.key)=\(.value)"] | add // "")
  + " \(.timestamp_ms)000000"
end
