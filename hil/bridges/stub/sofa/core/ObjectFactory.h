// A stand-in for SOFA's factory: it keeps the creator of the component registered last.
#pragma once

#include <functional>

#include <sofa/component/haptics/ForceFeedback.h>

namespace sofa::core {

using Creator = std::function<std::shared_ptr<objectmodel::BaseObject>()>;

class ObjectRegistrationData {
public:
    explicit ObjectRegistrationData(const std::string &) {}
    template <class Object> ObjectRegistrationData &add(bool = false)
    {
        creator = [] { return objectmodel::New<Object>(); };
        return *this;
    }
    Creator creator;
};

class ObjectFactory {
public:
    bool registerObjects(ObjectRegistrationData &data)
    {
        creator = data.creator;
        return creator != nullptr;
    }
    Creator creator;
};

} // namespace sofa::core

template <class Object> std::shared_ptr<Object> sofa::core::objectmodel::New()
{
    return std::shared_ptr<Object>(new Object());
}
