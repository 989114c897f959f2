//! Systems as data: recorded tasks, equations as text, and their derivatives.

mod equations;
mod policy;
mod recorded;
