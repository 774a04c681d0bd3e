//! New factors made on a thread of their own, one at a time, while the steps go on with the factors at hand.
//!
//! This is for bodies whose factor takes as long as several jets. The thread has the lowest priority, if its host gives
//! it one: on a core that it shares with the steps it uses the time that they leave.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use crate::fem::{Problem, Renewal};

/// One factor to be made: for a contact, of its state at a control.
#[derive(Debug)]
pub(super) struct Order {
    pub(super) renewal: Renewal,
    pub(super) contact: u16,
    pub(super) control_m: [f64; 3],
    pub(super) branch: u32,
}

/// The thread has ended: no factor comes from it any more.
#[derive(Debug)]
pub(super) struct Ended;

/// The thread, and the memory of a factor that goes there and back.
#[derive(Debug)]
pub(super) struct Renewals {
    orders: SyncSender<Box<Order>>,
    made: Receiver<Box<Order>>,
    spare: Option<Box<Order>>,
    begin: fn(),
}

impl Renewals {
    /// Starts the thread, which first calls `begin`.
    pub(super) fn new(problem: &Arc<Problem>, begin: fn()) -> Self {
        let (orders, ordered) = sync_channel::<Box<Order>>(1);
        let (done, made) = sync_channel(1);
        std::thread::spawn(move || {
            begin();
            for mut order in ordered {
                order.renewal.make();
                // Fails if the solver has ended, or has gone on to another model.
                if done.send(order).is_err() {
                    return;
                }
            }
        });
        let renewal = Renewal::like(problem);
        let order = Order { renewal, contact: 0, control_m: [0.0; 3], branch: 0 };
        Self { orders, made, spare: Some(Box::new(order)), begin }
    }

    /// The same for another model. What is being made is dropped.
    pub(super) fn for_problem(self, problem: &Arc<Problem>) -> Self {
        Self::new(problem, self.begin)
    }

    /// Whether a factor is being made.
    pub(super) fn is_busy(&self) -> bool {
        self.spare.is_none()
    }

    /// The memory of the next order, if none is being made.
    pub(super) fn room(&mut self) -> Option<Box<Order>> {
        self.spare.take()
    }

    /// Begins to make a factor.
    pub(super) fn begin(&mut self, order: Box<Order>) {
        // Fails if the thread has ended, which `ready` says.
        let _ = self.orders.send(order);
    }

    /// The order that is ready, if one is; to be given back. The thread may have ended.
    pub(super) fn ready(&mut self) -> Result<Option<Box<Order>>, Ended> {
        match self.made.try_recv() {
            Ok(order) => Ok(Some(order)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(Ended),
        }
    }

    /// Gives the memory back.
    pub(super) fn give_back(&mut self, order: Box<Order>) {
        self.spare = Some(order);
    }
}
