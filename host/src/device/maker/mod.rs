//! Devices behind their maker's library: a process of ours, the *proxy*, holds the library, and swaps forces and
//! measurements with the loop through shared memory.
//!
//! ```text
//! loop -> Proxied -> page (shared memory) -> Exchange, in the cycle of the maker's library -> device
//! ```
//!
//! Nothing of a maker is linked or shipped. The library or service is the one that the user has installed.

mod child;
pub mod cycles;
pub mod driven;
pub mod exchange;
pub mod force_dimension;
pub mod haply;
pub mod library;
pub mod page;
mod process;
mod proxied;
mod rotation;
pub mod touch;

pub use driven::{Driven, Opened};
pub use exchange::Exchange;
pub use force_dimension::Family;
pub use library::{Library, LibraryError};
pub use page::{Health, Measured};
pub use process::{Maker, ProxyPart, StartError, beside, serve_stdin, start};
pub use proxied::{Clock, Proxied};
