//! Named parameters of a network, wherever they are held.

use std::collections::BTreeMap;
use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};

use rogs_kernels::Precision;
use rogs_weights::{Error as WeightsError, ParameterSource, TensorFile};

use crate::{Error, Result};

/// One parameter in memory: its values as a flat tensor (the leaf that is trained) and its shape.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Values, row-major.
    pub values: Tensor<1>,
    /// Shape.
    pub shape: Vec<usize>,
}

/// Parameters by name. Tensors in memory shadow those of the source, so that a few can be trained or replaced.
pub struct Parameters {
    device: Device,
    memory: BTreeMap<String, Parameter>,
    source: Option<Arc<dyn ParameterSource>>,
    products: Precision,
}

impl Parameters {
    /// An empty store on a device.
    #[must_use]
    pub fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            memory: BTreeMap::new(),
            source: None,
            products: Precision::F32,
        }
    }

    /// A store that reads parameters from a source each time they are asked for.
    #[must_use]
    pub fn streaming(source: Box<dyn ParameterSource>, device: &Device) -> Self {
        Self {
            device: device.clone(),
            memory: BTreeMap::new(),
            source: Some(Arc::from(source)),
            products: Precision::F32,
        }
    }

    /// The device of the tensors.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Chooses numbers that the products of linear layers and 3x3 convolutions are made of, forwards and backwards, while
    /// gradients are recorded on the CPU. Sums, and everything else, stay f32.
    pub fn set_products(&mut self, products: Precision) {
        self.products = products;
    }

    /// Numbers that products are made of while gradients are recorded.
    #[must_use]
    pub fn products(&self) -> Precision {
        self.products
    }

    /// Adds or replaces a parameter.
    ///
    /// # Errors
    /// When the number of values does not fit the shape.
    pub fn insert(&mut self, name: &str, shape: &[usize], values: Vec<f32>) -> Result<()> {
        if shape.iter().product::<usize>() != values.len() {
            let (found, expected) = (vec![values.len()], shape.to_vec());
            return Err(WeightsError::WrongShape {
                name: name.to_owned(),
                found,
                expected,
            }
            .into());
        }
        let length = values.len();
        let values = Tensor::<1>::from_data(TensorData::new(values, [length]), &self.device);
        self.memory.insert(
            name.to_owned(),
            Parameter {
                values,
                shape: shape.to_vec(),
            },
        );
        Ok(())
    }

    /// The same parameters outside of differentiation: faster, and on the kernels that lifting uses. What is streamed stays
    /// streamed.
    #[must_use]
    pub fn without_gradients(&self) -> Self {
        let device = self.device.clone().without_autodiff();
        self.with_leaves(&device, |_, values| values.without_autodiff())
    }

    /// The same parameters as other leaves: `leaf` makes those in memory, what is streamed stays streamed.
    #[must_use]
    pub fn with_leaves(&self, device: &Device, leaf: impl Fn(&str, Tensor<1>) -> Tensor<1>) -> Self {
        let leaves = self.memory.iter().map(|(name, parameter)| {
            let values = leaf(name, parameter.values.clone().detach());
            let shape = parameter.shape.clone();
            (name.clone(), Parameter { values, shape })
        });
        Self {
            device: device.clone(),
            memory: leaves.collect(),
            source: self.source.clone(),
            products: self.products,
        }
    }

    /// The parameters in memory, by name; an optimiser changes their values here.
    pub fn memory_mut(&mut self) -> &mut BTreeMap<String, Parameter> {
        &mut self.memory
    }

    /// The parameters in memory, by name.
    #[must_use]
    pub fn memory(&self) -> &BTreeMap<String, Parameter> {
        &self.memory
    }

    /// Shape of a parameter, `None` when there is none of that name.
    #[must_use]
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        let streamed = || self.source.as_ref().and_then(|source| source.shape(name));
        self.memory
            .get(name)
            .map(|parameter| parameter.shape.as_slice())
            .or_else(streamed)
    }

    /// All names, ascending.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = self.memory.keys().cloned().collect();
        if let Some(source) = &self.source {
            names.extend(source.names().into_iter().map(str::to_owned));
        }
        names.sort_unstable();
        names.dedup();
        names
    }

    /// Values of a parameter on the host.
    ///
    /// # Errors
    /// When it is missing or cannot be read.
    pub fn host(&self, name: &str) -> Result<Vec<f32>> {
        if let Some(parameter) = self.memory.get(name) {
            return to_host(parameter.values.clone());
        }
        match &self.source {
            Some(source) => Ok(source.values(name)?),
            None => Err(WeightsError::MissingTensor { name: name.to_owned() }.into()),
        }
    }

    /// A parameter as a tensor of a known shape.
    ///
    /// # Errors
    /// When it is missing, cannot be read, or has another shape.
    pub fn get<const D: usize>(&self, name: &str, shape: [usize; D]) -> Result<Tensor<D>> {
        let found = self
            .shape(name)
            .ok_or_else(|| WeightsError::MissingTensor { name: name.to_owned() })?;
        if found != shape {
            let (found, expected) = (found.to_vec(), shape.to_vec());
            return Err(WeightsError::WrongShape {
                name: name.to_owned(),
                found,
                expected,
            }
            .into());
        }
        if let Some(parameter) = self.memory.get(name) {
            return Ok(parameter.values.clone().reshape(shape));
        }
        let values = self.host(name)?;
        Ok(Tensor::<D>::from_data(TensorData::new(values, shape), &self.device))
    }

    /// The part of the store whose names begin with `prefix` and a dot.
    #[must_use]
    pub fn scope(&self, prefix: &str) -> Scope<'_> {
        Scope {
            parameters: self,
            prefix: prefix.to_owned(),
        }
    }
}

/// The parameters below one prefix.
#[derive(Clone)]
pub struct Scope<'a> {
    parameters: &'a Parameters,
    prefix: String,
}

impl<'a> Scope<'a> {
    /// The scope `name` within this one.
    #[must_use]
    pub fn child(&self, name: impl std::fmt::Display) -> Self {
        Self {
            parameters: self.parameters,
            prefix: self.full(&name.to_string()),
        }
    }

    /// A parameter of this scope.
    ///
    /// # Errors
    /// As [`Parameters::get`].
    pub fn get<const D: usize>(&self, name: &str, shape: [usize; D]) -> Result<Tensor<D>> {
        self.parameters.get(&self.full(name), shape)
    }

    /// Whether the scope has a parameter of that name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.shape(name).is_some()
    }

    /// Shape of a parameter of this scope.
    #[must_use]
    pub fn shape(&self, name: &str) -> Option<&'a [usize]> {
        self.parameters.shape(&self.full(name))
    }

    /// The device of the tensors.
    #[must_use]
    pub fn device(&self) -> &'a Device {
        self.parameters.device()
    }

    /// As [`Parameters::products`].
    #[must_use]
    pub fn products(&self) -> Precision {
        self.parameters.products()
    }

    fn full(&self, name: &str) -> String {
        if self.prefix.is_empty() {
            name.to_owned()
        } else {
            format!("{}.{name}", self.prefix)
        }
    }
}

/// Values of a tensor on the host, row-major f32.
///
/// # Errors
/// When the device cannot hand them over.
pub fn to_host<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    let read = |error| Error::BadInput(format!("values could not be read from the device: {error}"));
    tensor.try_to_vec_as::<f32>().map_err(read)
}

/// A tensor on a device from host values.
#[must_use]
pub fn from_host<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::<D>::from_data(TensorData::new(values, shape), device)
}

/// All parameters of a file in memory.
///
/// # Errors
/// When a tensor cannot be read.
pub fn resident(file: &TensorFile, device: &Device) -> Result<Parameters> {
    let mut parameters = Parameters::new(device);
    for name in file.names() {
        let shape = file.shape(name).map(<[usize]>::to_vec).unwrap_or_default();
        parameters.insert(name, &shape, file.values(name)?)?;
    }
    Ok(parameters)
}
