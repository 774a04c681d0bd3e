//! The integration tests of recordings in one binary.

mod replay;
