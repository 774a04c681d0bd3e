//! One tick as a JSON message: encoding and decoding keep every bit.

use palpate_core::{Coverage, Fault, NodeWeight, Phase, Sample, Vec3, vec3};
use palpate_host::device::DeviceState;
use palpate_host::rt::{Applied, TickRecord};
use serde::{Deserialize, Serialize};

/// A tick as stored in the file. `tick.schema.json` documents the fields.
///
/// Absent values (`sample`, `coverage`, `fault`) are omitted, because viewers support no null in a schema.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Message<'m> {
    tick: u64,
    t_us: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    sample: Option<SampleMessage>,
    device: &'m str,
    zeroed: bool,
    reset: bool,
    arm: bool,
    disarm: bool,
    model: u8,
    hip_m: Vector,
    displacement_m: Vector,
    engaged: i32,
    shares: Vec<ShareMessage>,
    reaction_n: Vector,
    hand_force_n: Vector,
    #[serde(skip_serializing_if = "Option::is_none")]
    coverage: Option<&'m str>,
    phase: &'m str,
    #[serde(skip_serializing_if = "Option::is_none")]
    fault: Option<&'m str>,
    ramp: f32,
    clamped: bool,
    hand_work_j: f32,
    damped: bool,
    compute_ns: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device_ns: Option<u64>,
    lateness_ns: u64,
    skipped_periods: u64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SampleMessage {
    t_us: u64,
    position_m: Vector,
    buttons: u32,
}

/// An engaged space and its weight.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShareMessage {
    space: u16,
    weight: f32,
}

/// A vector. JSON has no NaN and no infinity: a vector with such a component also stores its bits.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Vector {
    #[serde(skip_serializing_if = "Option::is_none")]
    x: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    y: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    z: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bits: Option<[u32; 3]>,
}

impl From<Vec3> for Vector {
    fn from(vector: Vec3) -> Self {
        let [x, y, z] = vector.map(|component| Some(component).filter(|c| c.is_finite()));
        let bits = (!vec3::is_finite(vector)).then(|| vector.map(f32::to_bits));
        Self { x, y, z, bits }
    }
}

impl Vector {
    fn into_vec3(self) -> Option<Vec3> {
        match self.bits {
            Some(bits) => Some(bits.map(f32::from_bits)),
            None => Some([self.x?, self.y?, self.z?]),
        }
    }
}

const DISARMED: &str = "disarmed";
const ACTIVE: &str = "active";
const SAFE_ZERO: &str = "safe-zero";

/// Appends the message of a tick to `bytes`.
pub(super) fn encode(record: &TickRecord, bytes: &mut Vec<u8>) -> serde_json::Result<()> {
    let (phase, fault) = match record.phase {
        Phase::Disarmed => (DISARMED, None),
        Phase::Active => (ACTIVE, None),
        Phase::SafeZero(fault) => (SAFE_ZERO, Some(fault.name())),
    };
    let Applied { zeroed, reset, arm, disarm } = record.applied;
    let message = Message {
        tick: record.tick,
        t_us: record.t_us,
        sample: record.sample.map(|sample| SampleMessage {
            t_us: sample.t_us,
            position_m: sample.position_m.into(),
            buttons: sample.buttons,
        }),
        device: record.device.name(),
        zeroed,
        reset,
        arm,
        disarm,
        model: record.model,
        hip_m: record.hip_m.into(),
        displacement_m: record.displacement_m.into(),
        engaged: record.engaged.map_or(-1, i32::from),
        shares: record.shares.map(|NodeWeight { space, weight }| ShareMessage { space, weight }).into(),
        reaction_n: record.reaction_n.into(),
        hand_force_n: record.hand_force_n.into(),
        coverage: record.coverage.map(Coverage::name),
        phase,
        fault,
        ramp: record.ramp,
        clamped: record.clamped,
        hand_work_j: record.hand_work_j,
        damped: record.damped,
        compute_ns: record.compute_ns,
        device_ns: record.device_ns,
        lateness_ns: record.lateness_ns,
        skipped_periods: record.skipped_periods,
    };
    serde_json::to_writer(bytes, &message)
}

/// Decodes the tick of a message.
pub(super) fn decode(bytes: &[u8]) -> Result<TickRecord, String> {
    let message: Message<'_> = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let vector = |vector: Vector, name: &str| {
        vector.into_vec3().ok_or_else(|| format!("`{name}` has no three components"))
    };
    let phase = match (message.phase, message.fault) {
        (DISARMED, None) => Phase::Disarmed,
        (ACTIVE, None) => Phase::Active,
        (SAFE_ZERO, Some(name)) => {
            Phase::SafeZero(Fault::from_name(name).ok_or_else(|| format!("unknown fault `{name}`"))?)
        }
        (phase, _) => return Err(format!("invalid phase `{phase}`, or an invalid combination with `fault`")),
    };
    let coverage = |name| Coverage::from_name(name).ok_or_else(|| format!("unknown coverage `{name}`"));
    let engaged = match message.engaged {
        -1 => None,
        space => Some(u16::try_from(space).map_err(|_| format!("invalid space {space}"))?),
    };
    let sample = |sample: SampleMessage| -> Result<Sample, String> {
        let position_m = vector(sample.position_m, "sample.position_m")?;
        Ok(Sample { t_us: sample.t_us, position_m, buttons: sample.buttons })
    };
    let device = DeviceState::ALL.into_iter().find(|device| device.name() == message.device);
    let shares: Vec<NodeWeight> =
        message.shares.iter().map(|&ShareMessage { space, weight }| NodeWeight { space, weight }).collect();
    Ok(TickRecord {
        tick: message.tick,
        t_us: message.t_us,
        sample: message.sample.map(sample).transpose()?,
        device: device.ok_or_else(|| format!("unknown device state `{}`", message.device))?,
        applied: Applied {
            zeroed: message.zeroed,
            reset: message.reset,
            arm: message.arm,
            disarm: message.disarm,
        },
        model: message.model,
        hip_m: vector(message.hip_m, "hip_m")?,
        displacement_m: vector(message.displacement_m, "displacement_m")?,
        engaged,
        shares: shares.try_into().map_err(|_| "`shares` does not have three elements".to_owned())?,
        reaction_n: vector(message.reaction_n, "reaction_n")?,
        hand_force_n: vector(message.hand_force_n, "hand_force_n")?,
        coverage: message.coverage.map(coverage).transpose()?,
        phase,
        ramp: message.ramp,
        clamped: message.clamped,
        hand_work_j: message.hand_work_j,
        damped: message.damped,
        compute_ns: message.compute_ns,
        device_ns: message.device_ns,
        lateness_ns: message.lateness_ns,
        skipped_periods: message.skipped_periods,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use serde_json::Value;

    /// A record in which every field has a value.
    pub(crate) fn full() -> TickRecord {
        TickRecord {
            tick: 1_234,
            t_us: 1_234_056,
            sample: Some(Sample { t_us: 1_234_001, position_m: [0.1, -0.2, 1.0e-9], buttons: 5 }),
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
            hand_force_n: [-1.0 / 3.0, -2.0, 7.0],
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
        }
    }

    fn text(record: &TickRecord) -> String {
        let mut bytes = Vec::new();
        encode(record, &mut bytes).expect("memory is enough");
        String::from_utf8(bytes).expect("JSON is text")
    }

    /// Every bit, also of floats that are not finite.
    fn bits(record: &TickRecord) -> (Vec<u32>, String) {
        let vectors = [record.hip_m, record.displacement_m, record.reaction_n, record.hand_force_n];
        let position_m = record.sample.map_or([0.0; 3], |sample| sample.position_m);
        let all = vectors.into_iter().chain([position_m]).flatten().map(f32::to_bits).collect();
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
                sample: Some(Sample { t_us: 0, position_m, buttons: 0 }),
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
        let sample = Sample { t_us: 7, position_m: [0.5, nan, f32::NEG_INFINITY], buttons: 0 };
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
        ] {
            assert!(good.contains(from), "{from} in {good}");
            let refused = decode(good.replacen(from, to, 1).as_bytes()).expect_err("nonsense");
            assert!(refused.contains(reason), "{refused}");
        }
    }
}
