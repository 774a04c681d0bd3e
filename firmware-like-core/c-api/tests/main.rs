//! Tests of the C interface: its functions, and its header.

mod calls;
mod header;
