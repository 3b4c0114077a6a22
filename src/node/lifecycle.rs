//! Lifecycle of a node, by the services that `ros2 lifecycle` and lifecycle managers use.
//!
//! r2r has no lifecycle nodes. A node is unconfigured while it has only parameters and these services; configuring it loads its
//! files and creates its topics; it is active while its parameter `enabled` is true. Cleaning it up drops its ROS node and
//! creates it anew.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use anyhow::Context as _;
use r2r::lifecycle_msgs::{msg, srv};
use r2r::{QosProfile, ServiceRequest};

use super::log::Log;
use super::parameter_services::Setter;
use super::params::{Allowed, Parameter};
use super::runtime::{Follower, Runtime};
use super::shutdown::Shutdown;

/// Time between two looks at the state for `~/transition_event`.
const INTERVAL: Duration = Duration::from_millis(50);

/// Declares the parameter `autostart`.
pub(crate) fn parameter() -> Parameter {
    Parameter::fixed(
        "autostart",
        true,
        Allowed::Any,
        "Configure and activate the node at start; false: wait for the lifecycle services.",
    )
}

/// State of `lifecycle_msgs/msg/State`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Unconfigured = 1,
    Inactive = 2,
    Active = 3,
    Finalized = 4,
}

/// A transition: code, label, states before and after.
type Transition = (u8, &'static str, State, State);

const CONFIGURE: u8 = 1;
const CLEANUP: u8 = 2;
const ACTIVATE: u8 = 3;
const DEACTIVATE: u8 = 4;

/// All transitions of `lifecycle_msgs/msg/Transition` that may be asked for.
const TRANSITIONS: [Transition; 7] = [
    (CONFIGURE, "configure", State::Unconfigured, State::Inactive),
    (CLEANUP, "cleanup", State::Inactive, State::Unconfigured),
    (ACTIVATE, "activate", State::Inactive, State::Active),
    (DEACTIVATE, "deactivate", State::Active, State::Inactive),
    (5, "shutdown", State::Unconfigured, State::Finalized),
    (6, "shutdown", State::Inactive, State::Finalized),
    (7, "shutdown", State::Active, State::Finalized),
];

/// Lifecycle of the node of this program; clones share it.
#[derive(Clone)]
pub(crate) struct Lifecycle(Rc<RefCell<Inner>>);

struct Inner {
    is_configured: bool,
    /// Request to configure the node, until that succeeded or failed.
    configuring: Option<ServiceRequest<srv::ChangeState::Service>>,
    /// True if the node is to be created anew.
    cleaned_up: bool,
    /// True if the present ROS node is about to end, so that it takes no further request.
    is_ending: bool,
    /// Ends the program.
    program: Shutdown,
    /// Ends the present ROS node.
    node: Shutdown,
}

impl Follower for Lifecycle {
    /// Marks the node as configured and answers the request for that, if there was one.
    fn configured(&self, log: &Log) {
        let request = {
            let mut inner = self.0.borrow_mut();
            inner.is_configured = true;
            inner.configuring.take()
        };
        if let Some(request) = request {
            answer(request, true, log);
        }
    }

    /// Answers a request to configure the node that failed. Returns true if an answer may still be on its way: that one, or that to
    /// the request that ends the node.
    fn ended(&self, log: &Log) -> bool {
        let (request, was_asked) = {
            let mut inner = self.0.borrow_mut();
            (inner.configuring.take(), std::mem::replace(&mut inner.is_ending, true))
        };
        let is_pending = request.is_some();
        if let Some(request) = request {
            answer(request, false, log);
        }
        is_pending || was_asked
    }
}

impl Lifecycle {
    /// Starts with a node that is unconfigured.
    pub(crate) fn new(program: &Shutdown) -> Self {
        Self(Rc::new(RefCell::new(Inner {
            is_configured: false,
            configuring: None,
            cleaned_up: false,
            is_ending: false,
            program: program.clone(),
            node: program.child(),
        })))
    }

    /// Offers the services on a new ROS node. Returns the flag that ends this node.
    ///
    /// # Errors
    /// If ROS refuses a service or topic.
    pub(crate) fn serve(&self, runtime: &mut Runtime) -> anyhow::Result<Shutdown> {
        let setter = Rc::clone(runtime.extension::<Rc<Setter>>().context("the node has no parameter services")?);
        let node = {
            let mut inner = self.0.borrow_mut();
            inner.node = inner.program.child();
            (inner.is_configured, inner.cleaned_up, inner.is_ending) = (false, false, false);
            inner.configuring = None;
            inner.node.clone()
        };
        let (lifecycle, log) = (self.clone(), runtime.log().clone());
        runtime.deferred_service::<srv::ChangeState::Service>("~/change_state", move |request| {
            lifecycle.change(request, &setter, &log);
        })?;
        let lifecycle = self.clone();
        let parameters = std::sync::Arc::clone(runtime.parameters());
        let state = Rc::new(move || lifecycle.state(parameters.get("enabled")));
        let present = Rc::clone(&state);
        runtime.service::<srv::GetState::Service>("~/get_state", move |_| srv::GetState::Response {
            current_state: state_message(present()),
        })?;
        let all = [State::Unconfigured, State::Inactive, State::Active, State::Finalized];
        runtime.service::<srv::GetAvailableStates::Service>("~/get_available_states", move |_| {
            srv::GetAvailableStates::Response { available_states: all.map(state_message).to_vec() }
        })?;
        let present = Rc::clone(&state);
        runtime.service::<srv::GetAvailableTransitions::Service>("~/get_available_transitions", move |_| {
            descriptions(|(.., before, _)| *before == present())
        })?;
        runtime
            .service::<srv::GetAvailableTransitions::Service>("~/get_transition_graph", |_| descriptions(|_| true))?;
        publish_events(runtime, move || state())?;
        Ok(node)
    }

    /// Serves an unconfigured node until it is to be configured; returns false if the program ends first.
    pub(crate) fn wait_for_configuration(&self, runtime: &mut Runtime, node: &Shutdown) -> bool {
        while !node.requested() && self.0.borrow().configuring.is_none() {
            runtime.spin_for(Duration::from_millis(10));
        }
        !node.requested()
    }

    /// Returns true once the node's topics exist.
    pub(crate) fn is_configured(&self) -> bool {
        self.0.borrow().is_configured
    }

    /// Returns true if the node ended in order to be created anew.
    pub(crate) fn was_cleaned_up(&self) -> bool {
        self.0.borrow().cleaned_up
    }

    fn state(&self, enabled: bool) -> State {
        let inner = self.0.borrow();
        match (inner.is_configured, enabled) {
            _ if inner.program.requested() => State::Finalized,
            (false, _) => State::Unconfigured,
            (true, false) => State::Inactive,
            (true, true) => State::Active,
        }
    }

    /// Makes the transition that a request asks for, by its code or, if that is 0, by its label.
    fn change(&self, request: ServiceRequest<srv::ChangeState::Service>, setter: &Setter, log: &Log) {
        let wanted = &request.message.transition;
        let state = self.state(setter.parameters().get("enabled"));
        let is_wanted = |(code, label, before, _): &&Transition| {
            *before == state && if wanted.id == 0 { *label == wanted.label } else { *code == wanted.id }
        };
        let Some((code, label, ..)) = TRANSITIONS.iter().find(is_wanted) else {
            log.warn(format!(
                "transition {} {:?} does not leave the state {}",
                wanted.id,
                wanted.label,
                label_of(state)
            ));
            return answer(request, false, log);
        };
        let is_busy = {
            let inner = self.0.borrow();
            inner.configuring.is_some() || inner.is_ending
        };
        if is_busy {
            return answer(request, false, log);
        }
        log.info(format!("lifecycle: {label}"));
        match *code {
            CONFIGURE => {
                self.0.borrow_mut().configuring = Some(request);
                return;
            }
            ACTIVATE | DEACTIVATE => {
                let set = setter.set_one("enabled", *code == ACTIVATE);
                return answer(request, set.is_ok(), log);
            }
            CLEANUP => {
                let mut inner = self.0.borrow_mut();
                (inner.cleaned_up, inner.is_ending) = (true, true);
                inner.node.request();
            }
            _ => {
                let mut inner = self.0.borrow_mut();
                inner.is_ending = true;
                inner.program.request();
            }
        }
        answer(request, true, log);
    }
}

/// Publishes each change of the state on `~/transition_event`.
fn publish_events(runtime: &mut Runtime, state: impl Fn() -> State + 'static) -> anyhow::Result<()> {
    let events = runtime.native_publisher::<msg::TransitionEvent>("~/transition_event", QosProfile::default())?;
    let mut before = state();
    runtime.every(INTERVAL, move |runtime| {
        let now = state();
        let way = TRANSITIONS.iter().find(|(_, _, from, to)| (*from, *to) == (before, now));
        if let Some((code, label, from, to)) = way {
            let event = msg::TransitionEvent {
                timestamp: runtime.clock().now().nanos().max(0) as u64,
                transition: msg::Transition { id: *code, label: (*label).to_owned() },
                start_state: state_message(*from),
                goal_state: state_message(*to),
            };
            if let Err(error) = events.publish(&event) {
                runtime.log().warn_throttled("lifecycle", format!("~/transition_event: {error}"));
            }
        }
        before = now;
    });
    Ok(())
}

fn descriptions(wanted: impl Fn(&Transition) -> bool) -> srv::GetAvailableTransitions::Response {
    let describe = |(code, label, from, to): &Transition| msg::TransitionDescription {
        transition: msg::Transition { id: *code, label: (*label).to_owned() },
        start_state: state_message(*from),
        goal_state: state_message(*to),
    };
    let available_transitions = TRANSITIONS.iter().filter(|transition| wanted(transition)).map(describe).collect();
    srv::GetAvailableTransitions::Response { available_transitions }
}

fn state_message(state: State) -> msg::State {
    msg::State { id: state as u8, label: label_of(state).to_owned() }
}

fn label_of(state: State) -> &'static str {
    match state {
        State::Unconfigured => "unconfigured",
        State::Inactive => "inactive",
        State::Active => "active",
        State::Finalized => "finalized",
    }
}

fn answer(request: ServiceRequest<srv::ChangeState::Service>, success: bool, log: &Log) {
    if let Err(error) = request.respond(srv::ChangeState::Response { success }) {
        log.warn_throttled("change_state", format!("~/change_state: cannot send the response: {error}"));
    }
}
