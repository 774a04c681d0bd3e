//! Integers as little-endian bytes of fixed length: `#[serde(with = "fixed")]`.
//!
//! The integers of postcard are varints. With integers of fixed length all frames of a kind are equally long,
//! so their time on the wire is known, and a firmware in C can read them as a packed struct. For the torques
//! and times of a session they need no additional byte. `postcard::fixint` does the same, but not for arrays.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// An integer, or three, and its bytes.
pub(super) trait Fixed: Copy {
    /// Little-endian bytes.
    type Bytes;
    fn to_bytes(self) -> Self::Bytes;
    fn from_bytes(bytes: Self::Bytes) -> Self;
}

macro_rules! fixed {
    ($($integer:ident),*) => {$(
        impl Fixed for $integer {
            type Bytes = [u8; size_of::<$integer>()];

            fn to_bytes(self) -> Self::Bytes {
                self.to_le_bytes()
            }

            fn from_bytes(bytes: Self::Bytes) -> Self {
                Self::from_le_bytes(bytes)
            }
        }
    )*};
}
fixed!(u16, u32, i32);

impl<T: Fixed> Fixed for [T; 3] {
    type Bytes = [T::Bytes; 3];

    fn to_bytes(self) -> Self::Bytes {
        self.map(T::to_bytes)
    }

    fn from_bytes(bytes: Self::Bytes) -> Self {
        bytes.map(T::from_bytes)
    }
}

/// The serialisation of [`Serialize`].
pub(super) fn serialize<T, S>(value: &T, serializer: S) -> Result<S::Ok, S::Error>
where
    T: Fixed<Bytes: Serialize>,
    S: Serializer,
{
    value.to_bytes().serialize(serializer)
}

/// The deserialisation of [`Deserialize`].
pub(super) fn deserialize<'de, T, D>(deserializer: D) -> Result<T, D::Error>
where
    T: Fixed<Bytes: Deserialize<'de>>,
    D: Deserializer<'de>,
{
    T::Bytes::deserialize(deserializer).map(T::from_bytes)
}
