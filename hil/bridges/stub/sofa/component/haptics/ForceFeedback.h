// A stand-in for SOFA's ForceFeedback and its base classes; signatures only, with plain bodies.
#pragma once

#include <iostream>
#include <memory>
#include <string>

#include <sofa/type/Transform.h>

namespace sofa::core::objectmodel {

enum class ComponentState { Undefined, Loading, Valid, Dirty, Busy, Invalid };

template <class T> class Data {
public:
    struct InitData {
        T value{};
        const char *name = "", *help = "";
    };
    explicit Data(const InitData &init) : value_(init.value) {}
    const T &getValue() const { return value_; }
    void setValue(const T &value) { value_ = value; }

private:
    T value_;
};

template <class T> std::shared_ptr<T> New();

class BaseObject {
public:
    virtual ~BaseObject() = default;
    virtual void init() {}
    template <class T> using Data = core::objectmodel::Data<T>;
    template <class T> typename Data<T>::InitData initData(Data<T> *, const char *name, const char *help) { return {T(), name, help}; }
    template <class T> typename Data<T>::InitData initData(Data<T> *, const T &value, const char *name, const char *help)
    {
        return {value, name, help};
    }
    Data<ComponentState> d_componentState{{ComponentState::Undefined}};
};

} // namespace sofa::core::objectmodel

namespace sofa::core::behavior {
class BaseController : public virtual objectmodel::BaseObject {};
} // namespace sofa::core::behavior

#define SOFA_CLASS(T, P)                                                                                                          \
    using SPtr = std::shared_ptr<T>;                                                                                              \
    template <class Object> friend std::shared_ptr<Object> sofa::core::objectmodel::New()
#define msg_error() std::cerr << "\n[ERROR] "
#define msg_warning() std::cerr << "\n[WARNING] "

namespace sofa::simulation {
class Node;
}

namespace sofa::component::haptics {

class ForceFeedback : public virtual core::behavior::BaseController {
public:
    Data<bool> d_activate;
    Data<int> d_indice;
    simulation::Node *context = nullptr;

    void init() override {}
    virtual void computeForce(SReal x, SReal y, SReal z, SReal u, SReal v, SReal w, SReal q, SReal &fx, SReal &fy, SReal &fz) = 0;
    virtual void computeWrench(const sofa::type::Transform<SReal> &, const sofa::type::SpatialVector<SReal> &,
                               sofa::type::SpatialVector<SReal> &) = 0;
    virtual void setReferencePosition(sofa::type::Transform<SReal> &) {}
    virtual bool isEnabled() { return true; }
    virtual void setLock(bool) {}

protected:
    ForceFeedback() : d_activate(initData(&d_activate, false, "activate", "")), d_indice(initData(&d_indice, 0, "indice", "")) {}
};

} // namespace sofa::component::haptics
