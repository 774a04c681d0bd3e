//! How serde writes the fields of a record: names for states, `-1` for no node, and every bit of a vector.

use crate::device::DeviceState;
use palpate_core::{Coverage, Fault, NodeWeight, Orientation, Phase, Sample, Vec3};
use serde::de::{Error, Unexpected};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

pub(super) use crate::vector_form as vector;

/// A sample; absent if the device sent none.
pub(super) mod sample {
    use super::*;

    #[derive(Serialize, Deserialize)]
    #[serde(remote = "Sample", deny_unknown_fields)]
    struct Form {
        t_us: u64,
        #[serde(with = "vector")]
        position_m: Vec3,
        buttons: u32,
        #[serde(default, skip_serializing_if = "is_identity", with = "Turn")]
        orientation: Orientation,
    }

    /// The quaternion w + x i + y j + z k; absent without a rotation.
    #[derive(Serialize, Deserialize)]
    #[serde(remote = "Orientation", deny_unknown_fields)]
    struct Turn {
        #[serde(with = "component")]
        w: f32,
        #[serde(with = "vector")]
        xyz: Vec3,
    }

    fn is_identity(orientation: &Orientation) -> bool {
        *orientation == Orientation::IDENTITY
    }

    #[derive(Serialize, Deserialize)]
    struct Given(#[serde(with = "Form")] Sample);

    pub(in super::super) fn serialize<S: Serializer>(
        sample: &Option<Sample>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        sample.map(Given).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Sample>, D::Error> {
        Ok(Option::<Given>::deserialize(from)?.map(|given| given.0))
    }
}

/// The reported force; absent without one.
pub(super) mod reported {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Given(#[serde(with = "vector")] Vec3);

    pub(in super::super) fn serialize<S: Serializer>(
        force_n: &Option<Vec3>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        force_n.map(Given).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Vec3>, D::Error> {
        Ok(Option::<Given>::deserialize(from)?.map(|given| given.0))
    }
}

/// A number. JSON has no NaN and no infinity: such a number is its bits in a string.
mod component {
    use super::*;

    #[derive(Serialize, Deserialize)]
    #[serde(untagged)]
    enum Form {
        Finite(f32),
        Bits(String),
    }

    pub(super) fn serialize<S: Serializer>(number: &f32, to: S) -> Result<S::Ok, S::Error> {
        let is_finite = number.is_finite();
        let form = if is_finite { Form::Finite(*number) } else { Form::Bits(number.to_bits().to_string()) };
        form.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
        match Form::deserialize(from)? {
            Form::Finite(number) => Ok(number),
            Form::Bits(bits) => bits.parse().map(f32::from_bits).map_err(D::Error::custom),
        }
    }
}

/// The engaged spaces and their weights.
pub(super) mod shares {
    use super::*;

    #[derive(Serialize, Deserialize)]
    #[serde(remote = "NodeWeight", deny_unknown_fields)]
    struct Form {
        space: u16,
        weight: f32,
    }

    #[derive(Serialize, Deserialize)]
    struct Share(#[serde(with = "Form")] NodeWeight);

    pub(in super::super) fn serialize<S: Serializer>(
        shares: &[NodeWeight; 3],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        shares.map(Share).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<[NodeWeight; 3], D::Error> {
        Ok(<[Share; 3]>::deserialize(from)?.map(|share| share.0))
    }
}

/// The engaged space; -1 for none, because viewers support no null.
pub(super) mod engaged {
    use super::*;

    pub(in super::super) fn serialize<S: Serializer>(
        engaged: &Option<u16>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        engaged.map_or(-1, i32::from).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u16>, D::Error> {
        match i32::deserialize(from)? {
            -1 => Ok(None),
            space => match u16::try_from(space) {
                Ok(space) => Ok(Some(space)),
                Err(_) => Err(D::Error::custom(format_args!("invalid space {space}"))),
            },
        }
    }
}

/// The state of the device by its name.
pub(super) mod device {
    use super::*;

    pub(in super::super) fn serialize<S: Serializer>(device: &DeviceState, to: S) -> Result<S::Ok, S::Error> {
        device.name().serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<DeviceState, D::Error> {
        let named = |name: &str| DeviceState::ALL.into_iter().find(|device| device.name() == name);
        by_name(&String::deserialize(from)?, named, "a device state")
    }
}

/// The coverage by its name; absent when free.
pub(super) mod coverage {
    use super::*;

    pub(in super::super) fn serialize<S: Serializer>(
        coverage: &Option<Coverage>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        coverage.map(Coverage::name).serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Coverage>, D::Error> {
        let name = Option::<String>::deserialize(from)?;
        name.map(|name| by_name(&name, Coverage::from_name, "a coverage")).transpose()
    }
}

/// The phase, and the fault of a safe zero, as two fields.
pub(super) mod phase {
    use super::*;

    const DISARMED: &str = "disarmed";
    const ACTIVE: &str = "active";
    const SAFE_ZERO: &str = "safe-zero";

    #[derive(Serialize)]
    struct Written {
        phase: &'static str,
        #[serde(skip_serializing_if = "Option::is_none")]
        fault: Option<&'static str>,
    }

    #[derive(Deserialize)]
    struct Read {
        phase: String,
        fault: Option<String>,
    }

    pub(in super::super) fn serialize<S: Serializer>(phase: &Phase, to: S) -> Result<S::Ok, S::Error> {
        let (phase, fault) = match phase {
            Phase::Disarmed => (DISARMED, None),
            Phase::Active => (ACTIVE, None),
            Phase::SafeZero(fault) => (SAFE_ZERO, Some(fault.name())),
        };
        Written { phase, fault }.serialize(to)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Phase, D::Error> {
        let Read { phase, fault } = Read::deserialize(from)?;
        match (phase.as_str(), fault) {
            (DISARMED, None) => Ok(Phase::Disarmed),
            (ACTIVE, None) => Ok(Phase::Active),
            (SAFE_ZERO, Some(name)) => Ok(Phase::SafeZero(by_name(&name, Fault::from_name, "a fault")?)),
            (phase, _) => Err(D::Error::custom(format_args!(
                "invalid phase `{phase}`, or an invalid combination with `fault`"
            ))),
        }
    }
}

fn by_name<T, E: Error>(name: &str, find: impl FnOnce(&str) -> Option<T>, expected: &str) -> Result<T, E> {
    find(name).ok_or_else(|| E::invalid_value(Unexpected::Str(name), &expected))
}
