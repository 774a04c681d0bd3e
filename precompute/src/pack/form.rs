//! In which form the energy of a scattered fit is packed: what the scene's needs say, or the cheapest tick whose blob fits.

use palpate_core::Method;

use super::{PackError, PackOptions, Packed, pack};
use crate::space::Store;
use crate::spec::{Form, FormNeeds};

/// Methods by what their ticks cost, the cheapest first (docs/measurements.md, section 4).
const BY_TICK: [Method; 2] = [Method::Energy, Method::Kernel];

/// The method whose tables the scene of a store needs. Packs what it must to know sizes: nothing where there is no limit.
pub fn needed_method(store: &Store, threads: usize) -> Result<Method, PackError> {
    method_for(store, store.identity()?.form, threads)
}

/// [`needed_method`] for other needs than the scene's.
pub fn method_for(store: &Store, needs: FormNeeds, threads: usize) -> Result<Method, PackError> {
    let FormNeeds { form, most_bytes } = needs;
    let asked: &[Method] = match form {
        Form::Auto => &BY_TICK,
        Form::Node => &[Method::Energy],
        Form::Kernel => &[Method::Kernel],
    };
    let mut smallest: Option<u64> = None;
    for &method in asked {
        let Some(limit) = most_bytes else { return Ok(method) };
        let packed = pack(store, &PackOptions { methods: &[method], intermediate: false, threads })?;
        if packed.without_kernel.is_empty() {
            let bytes = packed.bytes()?.len() as u64;
            if bytes <= limit {
                return Ok(method);
            }
            smallest = Some(smallest.map_or(bytes, |least| least.min(bytes)));
        } else if form == Form::Kernel {
            // Said by who asked for it.
            return Ok(method);
        }
    }
    Err(PackError::OverLimit { smallest: smallest.unwrap_or(0), most_bytes: most_bytes.unwrap_or(0) })
}

impl Packed {
    /// Refuses a blob in which a node has no kernel though its method is what the blob is for.
    pub fn expect_kernels(&self) -> Result<(), PackError> {
        match self.without_kernel.first() {
            None => Ok(()),
            Some(active) => Err(PackError::NoKernel { active: active.clone() }),
        }
    }
}
