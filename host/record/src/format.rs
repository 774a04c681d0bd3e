//! Names and version of the file. docs/formats.md, section 6, describes it.

/// The channel of the ticks.
pub const TOPIC: &str = "/palpate/tick";
/// Name of the schema of a tick.
pub const SCHEMA_NAME: &str = "palpate.Tick";
/// JSON schema of a tick. Plain types only (no unions, no references): viewers support nothing else.
pub const SCHEMA: &str = include_str!("tick.schema.json");
/// Version of messages and metadata. The reader refuses other versions.
pub const FORMAT: u32 = 3;

/// Name of the metadata record that opens a recording.
pub(crate) const SESSION: &str = "palpate.session";
/// Name of the metadata record that closes it.
pub(crate) const END: &str = "palpate.end";
