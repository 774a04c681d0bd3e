//! Names and version of the file. docs/formats.md, section 6, describes it.

/// The channel of the ticks.
pub const TOPIC: &str = "/palpate/tick";
/// Name of the schema of a tick.
pub const SCHEMA_NAME: &str = "palpate.Tick";
/// JSON schema of a tick. Plain types only (no unions, no references): viewers support nothing else.
pub const SCHEMA: &str = include_str!("tick.schema.json");
/// Version of messages and metadata. The reader refuses other versions.
pub const FORMAT: u32 = 3;

/// The channel of the jets of a live session: binary messages without a schema.
pub const JET_TOPIC: &str = "/palpate/jet";
/// Name of the attachment that holds the organ of a live session, whose blob no file keeps.
pub(crate) const ORGAN: &str = "organ.blob";
/// Longest record that a reader accepts: a damaged length must not cause a huge allocation.
pub(crate) const MAX_RECORD_LEN: usize = 1 << 26;

/// Name of the metadata record that opens a recording.
pub(crate) const SESSION: &str = "palpate.session";
/// Name of the metadata record that closes it.
pub(crate) const END: &str = "palpate.end";
