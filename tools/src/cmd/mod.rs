//! One file per command of `palpate`.

pub(crate) mod bench;
pub(crate) mod completions;
pub(crate) mod control;
pub(crate) mod demo;
pub(crate) mod doctor;
pub(crate) mod guard;
pub(crate) mod identify;
pub(crate) mod inspect;
pub(crate) mod live;
pub(crate) mod live_solver;
pub(crate) mod man;
pub(crate) mod map;
pub(crate) mod pack;
pub(crate) mod paper;
pub(crate) mod path;
pub(crate) mod plan;
pub(crate) mod precompute;
pub(crate) mod proxy;
pub(crate) mod query;
pub(crate) mod report;
pub(crate) mod run;
