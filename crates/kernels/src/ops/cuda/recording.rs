//! Work on a GPU that is recorded once, and then started as a whole: launching some hundred kernels one by one takes longer than
//! they run.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use candle_core::cuda_backend::WrapErr as _;
use candle_core::cuda_backend::cudarc::driver::{CudaGraph, sys};
use candle_core::{Result, Tensor, bail};

use super::gpu;
use crate::gpu as devices;

/// A function of tensors, as a CUDA graph. It reads the weights where they lay when it was recorded.
pub struct Recording {
    inputs: Vec<Tensor>,
    outputs: Vec<Tensor>,
    graph: Mutex<Graph>,
}

struct Graph(CudaGraph);

// SAFETY: a graph may be used by any thread, one at a time: it is only used under the lock of its recording.
unsafe impl Send for Graph {}

impl Recording {
    /// Records `work` on inputs of the shapes and types of `inputs`, contiguous. Nothing else may use the device meanwhile.
    ///
    /// # Errors
    /// If `work` fails, or does what can't be recorded, such as a copy to the host; also if another device of the same GPU is closed meanwhile,
    /// since CUDA then waits for all streams.
    pub fn new(inputs: &[&Tensor], work: impl Fn(&[Tensor]) -> Result<Vec<Tensor>>) -> Result<Self> {
        // Opening a device waits for all streams too.
        let _alone = devices::alone();
        let inputs = inputs.iter().map(|input| input.copy()).collect::<Result<Vec<_>>>()?;
        let Some(first) = inputs.first() else { bail!("a recording needs an input") };
        let device = gpu::device(first)?;
        // candle copies the strides of some tensors to the device; while this lives, it keeps and reuses such copies.
        let _strides = device.enable_cuda_graph_htod_cache();
        // Loads the kernels and makes the outputs, which stay where they are.
        let outputs = work(&inputs)?.iter().map(Tensor::copy).collect::<Result<Vec<_>>>()?;
        let stream = device.cuda_stream();
        stream.synchronize().w()?;
        stream.begin_capture(sys::CUstreamCaptureMode::CU_STREAM_CAPTURE_MODE_RELAXED).w()?;
        let recorded = work(&inputs).and_then(|values| {
            outputs.iter().zip(&values).try_for_each(|(output, value)| gpu::copy(output, &value.contiguous()?))
        });
        let end = || stream.end_capture(sys::CUgraphInstantiate_flags::CUDA_GRAPH_INSTANTIATE_FLAG_AUTO_FREE_ON_LAUNCH);
        // An error of earlier work would be returned here, and the stream would go on recording.
        let graph = end().or_else(|_| end());
        match (recorded, graph) {
            (Ok(()), Ok(Some(graph))) => Ok(Self { inputs, outputs, graph: Mutex::new(Graph(graph)) }),
            (Ok(()), Ok(None)) => bail!("the recording is empty"),
            (recorded, graph) => {
                // Memory of the failed recording can't be freed, which the next call would report.
                let _ = stream.synchronize();
                recorded?;
                Err(graph.w().err().unwrap_or_else(|| candle_core::Error::Msg("the recording failed".into())))
            }
        }
    }

    /// Queues the recorded work on other inputs of the same shapes and types, contiguous. Returns its outputs.
    ///
    /// # Errors
    /// If an input has another shape, type or device.
    pub fn run(&self, inputs: &[&Tensor]) -> Result<Vec<Tensor>> {
        if inputs.len() != self.inputs.len() {
            bail!("expected {} inputs, got {}", self.inputs.len(), inputs.len());
        }
        // Until the outputs are copied, no other thread may start the same work.
        let graph = self.graph.lock().unwrap_or_else(PoisonError::into_inner);
        self.inputs.iter().zip(inputs).try_for_each(|(own, input)| gpu::copy(own, input))?;
        graph.0.launch().w()?;
        self.outputs.iter().map(Tensor::copy).collect()
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording")
            .field("inputs", &self.inputs)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}
