//! The integration tests of recordings in one binary.

mod live;
mod replay;
