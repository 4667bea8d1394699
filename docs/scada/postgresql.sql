-- The tables of the gateway's historian (docs/historian.md), as the gateway creates them itself, too.
-- Written by ./dev docs; another schema than `loading`: replace it everywhere.
--
-- Where the gateway must not create tables (create_tables = false), it needs no more than this:
--   GRANT USAGE ON SCHEMA loading TO gateway;
--   GRANT SELECT ON loading.layout TO gateway;
--   GRANT INSERT ON loading.events, loading.visits, loading.states, loading.alarms TO gateway;

BEGIN;
-- Several gateways may begin at the same time.
SELECT pg_advisory_xact_lock(hashtext('loading gateway loading'));
CREATE SCHEMA IF NOT EXISTS "loading";
CREATE TABLE IF NOT EXISTS "loading".layout (version integer PRIMARY KEY, applied timestamptz NOT NULL DEFAULT now());
CREATE TABLE IF NOT EXISTS "loading".events (
    id text NOT NULL,
    t timestamptz,
    site text,
    instance text,
    bay text,
    kind text,
    stop boolean,
    may_move boolean,
    in_place boolean,
    held boolean,
    moved text,
    phase text,
    reason text,
    d boolean,
    radius_px double precision,
    distance_mm double precision,
    vision_quality text,
    range_quality text,
    sensor text,
    detail text,
    payload jsonb,
    PRIMARY KEY (id)
);
CREATE INDEX IF NOT EXISTS events_t ON "loading".events (t);
CREATE INDEX IF NOT EXISTS events_site_bay_t ON "loading".events (site, bay, t);
COMMENT ON TABLE "loading".events IS 'what happened in the bays; every event once';
COMMENT ON COLUMN "loading".events.id IS 'unique: <random number of the gateway''s start>-<count>; that of the same event over MQTT';
COMMENT ON COLUMN "loading".events.t IS 'when it happened';
COMMENT ON COLUMN "loading".events.site IS '`site` of the configuration';
COMMENT ON COLUMN "loading".events.instance IS '`instance` of the gateway';
COMMENT ON COLUMN "loading".events.bay IS 'name of the bay';
COMMENT ON COLUMN "loading".events.kind IS 'kind of the event (docs/mqtt.md)';
COMMENT ON COLUMN "loading".events.stop IS 'the truck must stop; also on whenever D is unknown';
COMMENT ON COLUMN "loading".events.may_move IS 'the truck may move: stop is off, nothing withholds it; no condition for loading';
COMMENT ON COLUMN "loading".events.in_place IS 'the truck is in place: the only condition for loading';
COMMENT ON COLUMN "loading".events.held IS 'in_place is held by the ranger alone: the marker is covered';
COMMENT ON COLUMN "loading".events.moved IS 'since it was in place, the truck left it without release: NO, DISTANCE, MARKER';
COMMENT ON COLUMN "loading".events.phase IS 'phase of the visit: a name of VisitPhase (docs/registers.md); for people';
COMMENT ON COLUMN "loading".events.reason IS 'why `stop` is on, by name';
COMMENT ON COLUMN "loading".events.d IS 'D(t), equation 14; null: unknowable';
COMMENT ON COLUMN "loading".events.radius_px IS 'marker radius R; null: vision is not GOOD';
COMMENT ON COLUMN "loading".events.distance_mm IS 'distance Z from the ranger; null: range is not GOOD';
COMMENT ON COLUMN "loading".events.vision_quality IS 'may the marker''s values be used; else why not, by name';
COMMENT ON COLUMN "loading".events.range_quality IS 'may the distance be used; else why not, by name';
COMMENT ON COLUMN "loading".events.sensor IS 'for the sensor events: vision, range or cross_check';
COMMENT ON COLUMN "loading".events.detail IS 'in words, for people; never to be parsed';
COMMENT ON COLUMN "loading".events.payload IS 'the complete event (docs/schemas/event.schema.json)';
CREATE TABLE IF NOT EXISTS "loading".visits (
    site text NOT NULL,
    instance text NOT NULL,
    bay text NOT NULL,
    begun_ms bigint NOT NULL,
    begun timestamptz,
    length_s double precision,
    ended_by text,
    at_mark_s double precision,
    to_position_s double precision,
    released_s double precision,
    in_place_s double precision,
    times_in_place integer,
    corrections integer,
    stop_latency_ms double precision,
    halt_s double precision,
    overrun_mm double precision,
    radius_px double precision,
    distance_mm double precision,
    offset_px double precision,
    offset_mm double precision,
    frame_id bigint,
    frame_at timestamptz,
    moved text,
    phases_s jsonb,
    faults jsonb,
    interrupted boolean,
    interruptions integer,
    off_s double precision,
    event_id text,
    PRIMARY KEY (site, instance, bay, begun_ms)
);
CREATE INDEX IF NOT EXISTS visits_begun ON "loading".visits (begun);
COMMENT ON TABLE "loading".visits IS 'the trucks'' visits, from arrival to leaving; every visit once. Times in s begin with the visit';
COMMENT ON COLUMN "loading".visits.site IS '`site` of the configuration';
COMMENT ON COLUMN "loading".visits.instance IS '`instance` of the gateway';
COMMENT ON COLUMN "loading".visits.bay IS 'name of the bay';
COMMENT ON COLUMN "loading".visits.begun_ms IS 'when it began, Unix time, ms; with the bay, its identity';
COMMENT ON COLUMN "loading".visits.begun IS 'the same';
COMMENT ON COLUMN "loading".visits.length_s IS 'until the bay was clear, or the truck was last seen';
COMMENT ON COLUMN "loading".visits.ended_by IS 'how it ended: clear, next_truck or gateway_off (docs/records.md)';
COMMENT ON COLUMN "loading".visits.at_mark_s IS 'from its begin to the first D = 1; null: never';
COMMENT ON COLUMN "loading".visits.to_position_s IS 'from its begin until it was first in place; null: never';
COMMENT ON COLUMN "loading".visits.released_s IS 'from its begin to the last release by the PLC; null: none';
COMMENT ON COLUMN "loading".visits.in_place_s IS 'time in place, in all';
COMMENT ON COLUMN "loading".visits.times_in_place IS 'how often it was in place';
COMMENT ON COLUMN "loading".visits.corrections IS 'reversals of the motion before it was in place, back and forth';
COMMENT ON COLUMN "loading".visits.stop_latency_ms IS 'from the newest measurement that showed D = 1 first to the decision; null: never';
COMMENT ON COLUMN "loading".visits.halt_s IS 'from this stop until the truck stood; by the speed over the last second; null: never';
COMMENT ON COLUMN "loading".visits.overrun_mm IS 'how far it rolled meanwhile; null: never';
COMMENT ON COLUMN "loading".visits.radius_px IS 'R when it was last found in place; null: never in place';
COMMENT ON COLUMN "loading".visits.distance_mm IS 'Z at that moment; null: never in place';
COMMENT ON COLUMN "loading".visits.offset_px IS 'marker minus aim point, to the right; null: no aim point';
COMMENT ON COLUMN "loading".visits.offset_mm IS 'the same in the plane of the marker; null: size not known';
COMMENT ON COLUMN "loading".visits.frame_id IS 'the picture in which it was found in place; null: never in place';
COMMENT ON COLUMN "loading".visits.frame_at IS 'when that was taken';
COMMENT ON COLUMN "loading".visits.moved IS 'it left its place without release: NO, DISTANCE or MARKER';
COMMENT ON COLUMN "loading".visits.phases_s IS 'time in each phase, by its name';
COMMENT ON COLUMN "loading".visits.faults IS 'array of reason, times and seconds';
COMMENT ON COLUMN "loading".visits.interrupted IS 'the gateway was restarted meanwhile';
COMMENT ON COLUMN "loading".visits.interruptions IS 'how often';
COMMENT ON COLUMN "loading".visits.off_s IS 'for how long the truck was not watched because of it';
COMMENT ON COLUMN "loading".visits.event_id IS 'the event that reported it';
CREATE TABLE IF NOT EXISTS "loading".states (
    t timestamptz NOT NULL,
    site text NOT NULL,
    instance text NOT NULL,
    bay text NOT NULL,
    stop boolean,
    may_move boolean,
    in_place boolean,
    held boolean,
    moved text,
    phase text,
    reason text,
    d boolean,
    radius_px double precision,
    distance_mm double precision,
    vision_quality text,
    range_quality text,
    u double precision,
    v double precision,
    z_vision_mm double precision,
    ne107 text,
    guidance text,
    to_go_mm double precision,
    closing_mm_s double precision,
    vision_hz double precision,
    range_hz double precision,
    vision_latency_ms double precision,
    PRIMARY KEY (site, bay, instance, t)
);
CREATE INDEX IF NOT EXISTS states_t ON "loading".states (t);
COMMENT ON TABLE "loading".states IS 'the bays'' states: one row for each period, and one with each change of an output. What was not written while the database was away is not there';
COMMENT ON COLUMN "loading".states.t IS 'when the state was computed';
COMMENT ON COLUMN "loading".states.site IS '`site` of the configuration';
COMMENT ON COLUMN "loading".states.instance IS '`instance` of the gateway';
COMMENT ON COLUMN "loading".states.bay IS 'name of the bay';
COMMENT ON COLUMN "loading".states.stop IS 'the truck must stop; also on whenever D is unknown';
COMMENT ON COLUMN "loading".states.may_move IS 'the truck may move: stop is off, nothing withholds it; no condition for loading';
COMMENT ON COLUMN "loading".states.in_place IS 'the truck is in place: the only condition for loading';
COMMENT ON COLUMN "loading".states.held IS 'in_place is held by the ranger alone: the marker is covered';
COMMENT ON COLUMN "loading".states.moved IS 'since it was in place, the truck left it without release: NO, DISTANCE, MARKER';
COMMENT ON COLUMN "loading".states.phase IS 'phase of the visit: a name of VisitPhase (docs/registers.md); for people';
COMMENT ON COLUMN "loading".states.reason IS 'why `stop` is on, by name';
COMMENT ON COLUMN "loading".states.d IS 'D(t), equation 14; null: unknowable';
COMMENT ON COLUMN "loading".states.radius_px IS 'marker radius R; null: vision is not GOOD';
COMMENT ON COLUMN "loading".states.distance_mm IS 'distance Z from the ranger; null: range is not GOOD';
COMMENT ON COLUMN "loading".states.vision_quality IS 'may the marker''s values be used; else why not, by name';
COMMENT ON COLUMN "loading".states.range_quality IS 'may the distance be used; else why not, by name';
COMMENT ON COLUMN "loading".states.u IS 'marker centre, to the right; null: vision is not GOOD';
COMMENT ON COLUMN "loading".states.v IS 'marker centre, downwards; null: vision is not GOOD';
COMMENT ON COLUMN "loading".states.z_vision_mm IS 'distance seen by the camera; null: vision is not GOOD, or not configured';
COMMENT ON COLUMN "loading".states.ne107 IS 'NAMUR NE 107: the signal that counts most, by name';
COMMENT ON COLUMN "loading".states.guidance IS 'instruction for the driver, by name';
COMMENT ON COLUMN "loading".states.to_go_mm IS 'until D = 1; negative: past it; null: not known';
COMMENT ON COLUMN "loading".states.closing_mm_s IS 'positive: the truck approaches; null: not known';
COMMENT ON COLUMN "loading".states.vision_hz IS 'vision results a second';
COMMENT ON COLUMN "loading".states.range_hz IS 'distances a second';
COMMENT ON COLUMN "loading".states.vision_latency_ms IS 'capture to result, newest frame';
INSERT INTO "loading".layout (version) VALUES (1) ON CONFLICT DO NOTHING;
CREATE TABLE IF NOT EXISTS "loading".alarms (
    id text NOT NULL,
    t timestamptz,
    site text,
    instance text,
    bay text,
    alarm text,
    kind text,
    title text,
    priority text,
    event text,
    before text,
    state text,
    detail text,
    who text,
    note text,
    PRIMARY KEY (id)
);
CREATE INDEX IF NOT EXISTS alarms_t ON "loading".alarms (t);
CREATE INDEX IF NOT EXISTS alarms_site_bay_t ON "loading".alarms (site, bay, t);
COMMENT ON TABLE "loading".alarms IS 'the journal of the alarms: every change of each, and who made it; every change once';
COMMENT ON COLUMN "loading".alarms.id IS 'unique: <random number of the gateway''s start>-alarm-<count>';
COMMENT ON COLUMN "loading".alarms.t IS 'when it happened';
COMMENT ON COLUMN "loading".alarms.site IS '`site` of the configuration';
COMMENT ON COLUMN "loading".alarms.instance IS '`instance` of the gateway';
COMMENT ON COLUMN "loading".alarms.bay IS 'name of the bay; null: of the gateway itself';
COMMENT ON COLUMN "loading".alarms.alarm IS '`<bay>.<kind>`, or `<kind>` of the gateway itself';
COMMENT ON COLUMN "loading".alarms.kind IS 'a row of docs/alarms.md';
COMMENT ON COLUMN "loading".alarms.title IS 'in words, for people; never to be parsed';
COMMENT ON COLUMN "loading".alarms.priority IS 'low, medium, high';
COMMENT ON COLUMN "loading".alarms.event IS 'what happened: occurs, returns, acknowledge, reset, shelve ... (docs/alarms.md)';
COMMENT ON COLUMN "loading".alarms.before IS 'the state that it left';
COMMENT ON COLUMN "loading".alarms.state IS 'of ISA-18.2, by its name in docs/alarms.md';
COMMENT ON COLUMN "loading".alarms.detail IS 'in words, when it was last announced; never to be parsed';
COMMENT ON COLUMN "loading".alarms.who IS 'the user who did it; empty: nobody';
COMMENT ON COLUMN "loading".alarms.note IS 'and why';
INSERT INTO "loading".layout (version) VALUES (2) ON CONFLICT DO NOTHING;
ALTER TABLE "loading".visits ADD COLUMN IF NOT EXISTS visible double precision;
COMMENT ON COLUMN "loading".visits.visible IS 'share of the rim seen, 0 to 1, median of the first pictures in place; null: not measured';
ALTER TABLE "loading".visits ADD COLUMN IF NOT EXISTS contrast double precision;
COMMENT ON COLUMN "loading".visits.contrast IS 'fall of redness across the rim, log units, likewise; null: not measured';
INSERT INTO "loading".layout (version) VALUES (3) ON CONFLICT DO NOTHING;
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS drive_enable boolean;
COMMENT ON COLUMN "loading".states.drive_enable IS 'the drive may run at the setpoint';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS drive_state text;
COMMENT ON COLUMN "loading".states.drive_state IS 'how far the approach is; null: no drive is configured';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS drive_speed_setpoint_mm_s double precision;
COMMENT ON COLUMN "loading".states.drive_speed_setpoint_mm_s IS 'speed for the drive, towards the spout positive; 0: stand';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS drive_stopping_mm double precision;
COMMENT ON COLUMN "loading".states.drive_stopping_mm IS 'way until standstill, at worst; null: not known, or no drive is configured';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_x_mm double precision;
COMMENT ON COLUMN "loading".states.pose_x_mm IS 'marker''s centre minus its place, to the picture''s right; null: not configured, or a sensor is not GOOD';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_y_mm double precision;
COMMENT ON COLUMN "loading".states.pose_y_mm IS 'likewise, downwards; null: as pose.x_mm';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_z_mm double precision;
COMMENT ON COLUMN "loading".states.pose_z_mm IS 'likewise, away from the camera; positive: to go; null: as pose.x_mm';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_x_sd_mm double precision;
COMMENT ON COLUMN "loading".states.pose_x_sd_mm IS 'standard deviation of x; null: as pose.x_mm';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_y_sd_mm double precision;
COMMENT ON COLUMN "loading".states.pose_y_sd_mm IS 'standard deviation of y; null: as pose.x_mm';
ALTER TABLE "loading".states ADD COLUMN IF NOT EXISTS pose_z_sd_mm double precision;
COMMENT ON COLUMN "loading".states.pose_z_sd_mm IS 'standard deviation of z; null: as pose.x_mm';
INSERT INTO "loading".layout (version) VALUES (4) ON CONFLICT DO NOTHING;
-- With the extension TimescaleDB `states` is a hypertable, without it an ordinary table.
DO $$ BEGIN
    IF EXISTS (SELECT FROM pg_extension WHERE extname = 'timescaledb') THEN
        PERFORM create_hypertable('"loading".states', 't', if_not_exists => true, migrate_data => true);
    END IF;
EXCEPTION WHEN OTHERS THEN
    RAISE WARNING 'states stays an ordinary table: %', SQLERRM;
END $$;
COMMIT;
