//! One tick as a JSON message: encoding and decoding keep every bit.

use palpate_host::TickRecord;

/// Appends the message of a tick to `bytes`.
pub(super) fn encode(record: &TickRecord, bytes: &mut Vec<u8>) -> serde_json::Result<()> {
    serde_json::to_writer(bytes, record)
}

/// Decodes the tick of a message. The error names the field.
pub(super) fn decode(bytes: &[u8]) -> Result<TickRecord, String> {
    serde_json::from_slice(bytes).map_err(|error| {
        // A second reading follows the path to the field, which takes time.
        let message = &mut serde_json::Deserializer::from_slice(bytes);
        serde_path_to_error::deserialize::<_, TickRecord>(message)
            .map_or_else(|error| error.to_string(), |_| error.to_string())
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use palpate_core::{Coverage, Fault, NodeWeight, Orientation, Phase, Sample, Solver, vec3};
    use palpate_host::device::DeviceState;
    use palpate_host::live::{LiveTick, Partner};
    use palpate_host::rt::Applied;
    use serde_json::Value;

    /// A record in which every field has a value.
    pub(crate) fn full() -> TickRecord {
        TickRecord {
            tick: 1_234,
            t_us: 1_234_056,
            sample: Some(Sample {
                t_us: 1_234_001,
                position_m: [0.1, -0.2, 1.0e-9],
                buttons: 5,
                orientation: Orientation { w: 0.8, xyz: [0.0, -0.6, 0.0] },
            }),
            device: DeviceState::Unhomed,
            applied: Applied { zeroed: true, reset: true, arm: false, disarm: true },
            model: 3,
            hip_m: [0.1, -0.0, 0.3],
            displacement_m: [0.001, 0.002, -0.003],
            engaged: Some(2),
            shares: [
                NodeWeight { space: 2, weight: 0.7 },
                NodeWeight { space: 9, weight: 0.1 + 0.2 },
                NodeWeight { space: 0, weight: 0.0 },
            ],
            reaction_n: [1.0 / 3.0, 2.0, -7.0],
            reaction_n_m: [0.0, 0.25, -0.5],
            hand_force_n: [-1.0 / 3.0, -2.0, 7.0],
            reported_n: Some([-0.25, -2.0, 6.5]),
            coverage: Some(Coverage::SuperCell),
            phase: Phase::SafeZero(Fault::Overspeed),
            ramp: 0.3,
            clamped: true,
            hand_work_j: -1.0 / 3.0,
            damped: true,
            compute_ns: 9_001,
            device_ns: Some(8_000),
            lateness_ns: 401,
            skipped_periods: 3,
            live: Some(LiveTick {
                jets: 41,
                sequence: 40,
                hand_overs: 9,
                fade_step_n: 0.5,
                solver: Solver::Silent,
                partner: Some(Partner {
                    position_m: [0.5, 0.25, -2.0],
                    velocity_m_s: [0.0; 3],
                    presses: true,
                }),
            }),
        }
    }

    fn text(record: &TickRecord) -> String {
        let mut bytes = Vec::new();
        encode(record, &mut bytes).expect("memory is enough");
        String::from_utf8(bytes).expect("JSON is text")
    }

    /// The bytes in the file are a contract: a renamed or reordered field shows here.
    #[test]
    fn the_text_of_a_message_is_kept() {
        assert_eq!(text(&full()), FULL);
        assert_eq!(text(&TickRecord::EMPTY), EMPTY);
        assert_eq!(decode(FULL.as_bytes()), Ok(full()));
        assert_eq!(decode(EMPTY.as_bytes()), Ok(TickRecord::EMPTY));
    }

    const FULL: &str = concat!(
        r#"{"tick":1234,"t_us":1234056,"sample":{"t_us":1234001,"position_m":{"x":0.1,"y":-0.2"#,
        r#","z":1e-9},"buttons":5,"orientation":{"w":0.8,"xyz":{"x":0.0,"y":-0.6,"z":0.0}}},"device":"unhomed","zeroed":true,"reset":true,"arm":false"#,
        r#","disarm":true,"model":3,"hip_m":{"x":0.1,"y":-0.0,"z":0.3},"displacement_m":{"x":0.001"#,
        r#","y":0.002,"z":-0.003},"engaged":2,"shares":[{"space":2,"weight":0.7},{"space":9"#,
        r#","weight":0.3},{"space":0,"weight":0.0}],"reaction_n":{"x":0.33333334,"y":2.0,"z":-7.0}"#,
        r#","reaction_n_m":{"x":0.0,"y":0.25,"z":-0.5},"hand_force_n":{"x":-0.33333334,"y":-2.0,"z":7.0}"#,
        r#","reported_n":{"x":-0.25,"y":-2.0,"z":6.5},"coverage":"supercell""#,
        r#","phase":"safe-zero","fault":"overspeed","ramp":0.3,"clamped":true"#,
        r#","hand_work_j":-0.33333334,"damped":true,"compute_ns":9001,"device_ns":8000"#,
        r#","lateness_ns":401,"skipped_periods":3,"live":{"jets":41,"sequence":40,"hand_overs":9,"fade_step_n":0.5"#,
        r#","solver":"silent","partner":{"position_m":{"x":0.5,"y":0.25,"z":-2.0},"velocity_m_s":{"x":0.0"#,
        r#","y":0.0,"z":0.0},"presses":true}}}"#,
    );
    const EMPTY: &str = concat!(
        r#"{"tick":0,"t_us":0,"device":"disconnected","zeroed":false,"reset":false,"arm":false"#,
        r#","disarm":false,"model":0,"hip_m":{"x":0.0,"y":0.0,"z":0.0},"displacement_m":{"x":0.0"#,
        r#","y":0.0,"z":0.0},"engaged":-1,"shares":[{"space":0,"weight":0.0},{"space":0"#,
        r#","weight":0.0},{"space":0,"weight":0.0}],"reaction_n":{"x":0.0,"y":0.0,"z":0.0}"#,
        r#","hand_force_n":{"x":0.0,"y":0.0,"z":0.0},"phase":"disarmed","ramp":0.0,"clamped":false"#,
        r#","hand_work_j":0.0,"damped":false,"compute_ns":0,"lateness_ns":0,"skipped_periods":0}"#,
    );

    /// Every bit, also of floats that are not finite.
    fn bits(record: &TickRecord) -> (Vec<u32>, String) {
        let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
        let sample = record.sample.unwrap_or_default();
        let Orientation { w, xyz } = sample.orientation;
        let all =
            vectors.into_iter().chain([sample.position_m, xyz, [w; 3]]).flatten().map(f32::to_bits).collect();
        (all, format!("{record:?}"))
    }

    #[test]
    fn every_field_survives_a_round_trip() {
        let mut records = vec![full(), TickRecord::EMPTY];
        records.extend(Fault::ALL.map(|fault| TickRecord { phase: Phase::SafeZero(fault), ..full() }));
        records.extend(Coverage::ALL.map(|kind| TickRecord { coverage: Some(kind), ..full() }));
        for record in records {
            assert_eq!(decode(text(&record).as_bytes()).as_ref().map(bits), Ok(bits(&record)));
        }
    }

    /// A full period of an odd multiplier visits patterns of every exponent.
    #[test]
    fn every_float_keeps_its_bits() {
        let mut pattern = 1_u32;
        let mut next = || {
            pattern = pattern.wrapping_mul(0x9e37_79b1).wrapping_add(0x7f4a_7c15);
            f32::from_bits(pattern)
        };
        let mut not_finite = 0;
        for _ in 0..60_000 {
            let position_m = [next(), next(), next()];
            not_finite += u32::from(!vec3::is_finite(position_m));
            let record = TickRecord {
                sample: Some(Sample { t_us: 0, position_m, ..Sample::default() }),
                reaction_n: [next(), next(), next()],
                ..full()
            };
            let back = decode(text(&record).as_bytes()).expect("our own message");
            assert_eq!(bits(&back).0, bits(&record).0, "{record:?}");
        }
        assert!(not_finite > 300, "NaN and infinity are among them: {not_finite}");
    }

    #[test]
    fn a_value_that_is_not_finite_is_stored_as_bits() {
        let nan = f32::from_bits(0x7fc0_1234);
        let orientation = Orientation { w: nan, xyz: [nan, 0.0, 0.0] };
        let sample =
            Sample { t_us: 7, position_m: [0.5, nan, f32::NEG_INFINITY], orientation, ..Sample::default() };
        let message = text(&TickRecord { sample: Some(sample), ..full() });
        assert!(
            message.contains(r#""position_m":{"x":0.5,"bits":[1056964608,2143294004,4286578688]}"#),
            "{message}"
        );
        let back = decode(message.as_bytes()).expect("our own").sample.expect("a sample");
        assert_eq!(back.position_m.map(f32::to_bits), sample.position_m.map(f32::to_bits));
    }

    /// Checks a value against the schema, for the keywords that our schema uses.
    fn fits(schema: &Value, value: &Value) -> Result<(), String> {
        let is = match schema["type"].as_str().expect("one plain type") {
            "object" => value.is_object(),
            "array" => value.is_array(),
            "integer" => value.is_i64() || value.is_u64(),
            "number" => value.is_number(),
            "boolean" => value.is_boolean(),
            "string" => value.is_string(),
            other => return Err(format!("a type that viewers do not support: {other}")),
        };
        if !is {
            return Err(format!("{value} is not of type {}", schema["type"]));
        }
        assert!(schema["description"].is_string(), "{schema} has a description");
        for name in schema["required"].as_array().into_iter().flatten() {
            let name = name.as_str().expect("a name");
            value.get(name).ok_or_else(|| format!("`{name}` is missing"))?;
        }
        for (name, member) in value.as_object().into_iter().flatten() {
            let part =
                schema["properties"].get(name).ok_or_else(|| format!("`{name}` is not in the schema"))?;
            fits(part, member).map_err(|error| format!("{name}: {error}"))?;
        }
        for item in value.as_array().into_iter().flatten() {
            fits(&schema["items"], item)?;
        }
        let allowed = schema["enum"].as_array();
        if allowed.is_some_and(|allowed| !allowed.contains(value)) {
            return Err(format!("{value} is not an allowed value"));
        }
        Ok(())
    }

    #[test]
    fn messages_fit_the_schema_and_use_all_of_it() {
        let schema: Value = serde_json::from_str(crate::SCHEMA).expect("the schema is JSON");
        let value = |record: &TickRecord| -> Value { serde_json::from_str(&text(record)).expect("JSON") };
        let all = value(&full());
        let mut records = vec![full(), TickRecord::EMPTY];
        records.extend(Fault::ALL.map(|fault| TickRecord { phase: Phase::SafeZero(fault), ..full() }));
        records.extend(Coverage::ALL.map(|kind| TickRecord { coverage: Some(kind), ..full() }));
        records.push(TickRecord { hip_m: [f32::NAN; 3], ..full() });
        for record in records {
            assert_eq!(fits(&schema, &value(&record)), Ok(()));
        }
        let names = |object: &Value| -> Vec<String> {
            object.as_object().expect("an object").keys().cloned().collect()
        };
        assert_eq!(names(&schema["properties"]), names(&all));
        assert_eq!(names(&schema["properties"]["sample"]["properties"]), names(&all["sample"]));

        let mut poorer = all.clone();
        poorer.as_object_mut().expect("an object").remove("hand_force_n");
        assert_eq!(fits(&schema, &poorer), Err("`hand_force_n` is missing".into()));
        let mut other = all;
        other["tick"] = "one".into();
        assert!(fits(&schema, &other).is_err());
    }

    /// Recordings made before the device's time was recorded separately.
    #[test]
    fn a_message_without_the_device_time_is_read() {
        let old = text(&full()).replace(r#""device_ns":8000,"#, "");
        assert!(!old.contains("device_ns"));
        let record = decode(old.as_bytes()).expect("an old message is valid");
        assert_eq!(record, TickRecord { device_ns: None, ..full() });
    }

    #[test]
    fn an_invalid_message_is_refused_with_its_reason() {
        let good = text(&full());
        for (from, to, reason) in [
            (r#""phase":"safe-zero""#, r#""phase":"active""#, "phase"),
            ("overspeed", "boredom", "boredom"),
            ("supercell", "hypercell", "hypercell"),
            (r#""engaged":2"#, r#""engaged":-2"#, "invalid space -2"),
            (r#""y":-0.2,"#, "", "sample.position_m"),
            (r#""clamped":true,"#, "", "clamped"),
            (r#""tick":1234"#, r#""tick":-1"#, "invalid value"),
            (r#""tick":1234"#, r#""tick":1234,"tock":1"#, "tock"),
            (r#""buttons":5"#, r#""buttons":5,"knobs":1"#, "knobs"),
        ] {
            assert!(good.contains(from), "{from} in {good}");
            let refused = decode(good.replacen(from, to, 1).as_bytes()).expect_err("nonsense");
            assert!(refused.contains(reason), "{refused}");
        }
    }
}
