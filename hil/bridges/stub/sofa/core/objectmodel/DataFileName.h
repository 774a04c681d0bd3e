// A stand-in for SOFA's data field of a file name.
#pragma once

#include <sofa/component/haptics/ForceFeedback.h>

namespace sofa::core::objectmodel {

class DataFileName : public Data<std::string> {
public:
    explicit DataFileName(const InitData &init) : Data<std::string>(init) {}
    const std::string &getFullPath() const { return getValue(); }
};

} // namespace sofa::core::objectmodel
